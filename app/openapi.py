"""The OpenAPI description: what the router knows, with the schemas of tasks and plan documents put in."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from planners.contract.plan_document import document_schema
from planners.contract.scan_spec import scan_schema
from planners.contract.task_spec import task_schema

COMPONENTS = "#/components/schemas/"


def install_openapi(app: FastAPI) -> None:
    """Have `app` describe itself, made once at the first request."""

    def describe() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = _describe(app)
        return app.openapi_schema

    app.openapi = describe


def _describe(app: FastAPI) -> dict[str, Any]:
    description = get_openapi(
        title=app.title, version=app.version, description=app.description, routes=app.routes, tags=app.openapi_tags
    )
    schemas = description.setdefault("components", {}).setdefault("schemas", {})
    for name, schema in (("PlanDocument", document_schema()), ("TaskSpec", task_schema()), ("ScanSpec", scan_schema())):
        component = _into_components(schema)
        schemas.update(component.pop("$defs", {}))
        schemas[name] = component
    return description


def _into_components(schema: Any) -> Any:
    """Point references at the description's components instead of the schema's own definitions."""
    if isinstance(schema, dict):
        return {
            key: value.replace("#/$defs/", COMPONENTS) if _is_reference(value) else _into_components(value)
            for key, value in schema.items()
        }
    return [_into_components(item) for item in schema] if isinstance(schema, list) else schema


def _is_reference(value: Any) -> bool:
    return isinstance(value, str) and value.startswith("#/$defs/")
