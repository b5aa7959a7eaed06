"""The OpenAPI description: what the router knows, with the schemas of tasks and plan documents put in."""

from __future__ import annotations

import json
from importlib import resources
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from app.access.access_control import needed_scope
from app.access.authenticator import COOKIE
from app.errors import MEDIA_TYPE as PROBLEM_MEDIA_TYPE
from planners.cell.bundle import cell_schema
from planners.contract.scan_spec import scan_schema
from planners.contract.strict_yaml import parse_yaml
from planners.contract.study_spec import StudySpec
from planners.contract.task_spec import task_schema
from planners.plan.plan import plan_schema

COMPONENTS = "#/components/schemas/"
EXAMPLE_TASK = "ab1.json"
EXAMPLE_CELL = "dual_ur3e_lift.yaml"
EXAMPLE_AXES = [
    {"pointer": "/cup/position/0", "min": -0.12, "max": 0.12, "count": 5},
    {"pointer": "/lifter_model", "values": ["paper", "cable", "dexnet"]},
]
ALWAYS_ANSWERED = "/livez"
SECURITY_SCHEMES = {
    "key": {"type": "http", "scheme": "bearer", "description": "A key of `liftwright keys issue`"},
    "session": {"type": "apiKey", "in": "cookie", "name": COOKIE, "description": "What a browser gets for a key"},
}


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
    stated = {
        "PlanDocument": plan_schema(),
        "TaskSpec": task_schema(),
        "ScanSpec": scan_schema(),
        "StudySpec": StudySpec.model_json_schema(),
        "CellFile": cell_schema(),
    }
    for name, schema in stated.items():
        component = _into_components(schema)
        schemas.update(component.pop("$defs", {}))
        schemas[name] = component
    description["components"]["securitySchemes"] = SECURITY_SCHEMES
    for path, operations in description["paths"].items():
        for method, operation in operations.items():
            _complete(method.upper(), path, operation)
    schemas.pop("HTTPValidationError", None)
    schemas.pop("ValidationError", None)
    return description


def _complete(method: str, path: str, operation: dict[str, Any]) -> None:
    """Say what holds for all operations: who may call, and how errors are told."""
    scope = needed_scope(method, path)
    operation["security"] = [] if scope is None else [{name: []} for name in SECURITY_SCHEMES]
    answers = operation["responses"]
    if operation.get("parameters"):
        answers.setdefault("422", {"description": "A parameter that is not valid"})
    if "requestBody" in operation:
        if (example := _example(path)) is not None:
            operation["requestBody"]["content"]["application/json"]["example"] = example
        answers.setdefault("408", {"description": "The body does not come"})
    if scope is not None:
        answers.setdefault("401", {"description": "No valid key"})
        answers.setdefault("429", {"description": "Too many requests: `Retry-After`"})
        answers.setdefault("403", {"description": f"The key has not the scope `{scope.value}`"})
    if path != ALWAYS_ANSWERED:
        answers.setdefault("503", {"description": "The service cannot work right now; `Retry-After`"})
    for status, answer in answers.items():
        if status >= "400":
            answer["content"] = {PROBLEM_MEDIA_TYPE: {"schema": {"$ref": f"{COMPONENTS}ProblemDocument"}}}
    operation["responses"] = dict(sorted(answers.items()))


def _example(path: str) -> Any:
    """Return a body for an operation, as JSON data; None: it has no example."""
    assets = resources.files("assets")
    match path:
        case "/v1/plans" | "/v1/tasks/check":
            return json.loads(assets.joinpath("tasks", EXAMPLE_TASK).read_bytes())
        case "/v1/studies":
            return {"task": json.loads(assets.joinpath("tasks", EXAMPLE_TASK).read_bytes()), "axes": EXAMPLE_AXES}
        case "/v1/cells" | "/v1/surveys":
            return {**parse_yaml(assets.joinpath("cells", EXAMPLE_CELL).read_bytes())[0], "name": "my_cell"}
        case "/v1/webhooks":
            return {"url": "https://mes.example.com/liftwright", "plans": "all"}
        case _:
            return None


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
