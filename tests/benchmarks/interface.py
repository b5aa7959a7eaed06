"""The whole interface at random, with a model beside it: several owners, everything that they may do, and restarts.

Of rules hypothesis favours the first by name, which is why things are posted most often. Nobody works on jobs: where
one is begun or ends, its worker is played by writing into the stores as a worker does.
"""

from __future__ import annotations

import gzip
import hashlib
import json
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import sqlalchemy as sa
from hypothesis import HealthCheck, Phase, seed, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule, run_state_machine_as_test

from app.access.caller import Scope
from planners.cell.cell import known_cells
from planners.study.study_map import StudyPoint
from tests.support.interface_model import (
    MAX_DELAYED,
    MAX_QUEUED,
    MAX_QUEUED_OF_OWNER,
    MAX_STUDIES,
    MAX_WEBHOOKS,
    SCOPES,
    STATION,
    Cell,
    Key,
    Plan,
    Scene,
    Study,
    T,
    Thing,
    Webhook,
    World,
    known_by,
    listed,
    pages,
)
from tests.support.mesh_bombs import meshes
from tests.support.own_cell import station
from tests.support.own_service import OwnService, sparing_repeats
from tests.support.scan_frames import SHIPPED
from tests.support.scan_frames import shipped as shipped_scan
from tests.support.service import task
from workers.stores.jobs import FAILED, RUNNING, SUCCEEDED, workflow_table
from workers.stores.plan_store import PackedDocument
from workers.stores.tables import now_us

LIMITS = {
    "authentication": "required", "requests_per_second": 1e6, "request_burst": 10**6, "max_body_bytes": 50_000,
    "max_queued": MAX_QUEUED, "max_queued_of_owner": MAX_QUEUED_OF_OWNER, "max_delayed": MAX_DELAYED,
    "max_webhooks": MAX_WEBHOOKS, "max_studies": MAX_STUDIES,
}  # fmt: skip
PROBLEM = "application/problem+json"
NOBODY = Thing("0" * 32, "nobody", gone=True)
"""Stands for what was never there."""
LATER = "2999-01-01T00:00:00Z"
SCAN = shipped_scan()
SEEN = json.loads((SHIPPED / "tissue_boxes" / "task.json").read_text())
IN_STATION = {"plate_pose": [0.6, 0.0, 0.922, 1, 0, 0, 0], "options": {"simulate": False}}
NAMES = (None, "JO-1", "jo-1%", "größer")
"""What tasks and orders are called: what a search by a part of a name might take for a pattern is among them."""
IN_THE_AIR = [0.3, 0, 1.5, 1, 0, 0, 0]
X = {"pointer": "/cup/position/0", "values": [-0.05, 0.0, 0.05]}
MANY = {"pointer": "/cup/position/1", "min": -0.1, "max": 0.1, "count": 5}
JSON = {"Content-Type": "application/json"}

BAD_TASKS: dict[str, tuple[Any, str]] = {
    "no object": ([], ""),
    "unknown kind": (task(kind="dance"), "/kind"),
    "text for a number": (task(plate={**task()["plate"], "mass": "4"}), "/plate/mass"),
    "unknown member": (task(colour="red"), "/colour"),
    "unknown cell": (task(cell="moon_base"), "/cell"),
    "in the air": (task(plate_pose=IN_THE_AIR), "/plate_pose"),
    "unknown scene": ({**SEEN, "scene_id": "0" * 32}, "/scene_id"),
    "no scene": (SEEN, "/scene_id"),
}
BAD_STUDIES: dict[str, tuple[Any, str]] = {
    "no axes": ({"task": task()}, "/axes"),
    "unknown member": ({"task": task(), "axes": [X], "colour": 1}, "/colour"),
    "bad task": ({"task": task(colour="red"), "axes": [X]}, "/task/colour"),
    "no axis": ({"task": task(), "axes": [{"pointer": "/cup/position/0"}]}, "/axes/0"),
    "unknown cell": ({"task": task(cell="moon_base"), "axes": [X]}, "/task/cell"),
    "strange member": ({"task": task(), "axes": [{"pointer": "/colour", "values": [1]}]}, "/axes/0/pointer"),
}
BAD_WEBHOOKS: dict[str, tuple[Any, str]] = {
    "no TLS": ({"url": "http://example.com"}, "/url"),
    "an address of this machine": ({"url": "https://127.0.0.1/"}, "/url"),
    "no URL": ({}, "/url"),
    "unknown member": ({"url": "https://example.com", "colour": 1}, "/colour"),
    "other plans": ({"url": "https://example.com", "plans": "some"}, "/plans"),
}
BAD_QUERIES = (
    ("GET", "/v1/plans", "page_size", "0"), ("GET", "/v1/plans", "colour", "red"), ("GET", "/v1/plans", "state", "x"),
    ("GET", "/v1/plans", "created_from", "yesterday"), ("GET", "/v1/plans", "created_until", "2026-01-01T00:00:00"),
    ("GET", "/v1/scenes", "page_size", "201"), ("GET", "/v1/studies", "page_size", "x"),
    ("GET", "/v1/webhooks", "page_size", "0"), ("POST", "/v1/plans", "priority", "10"),
    ("POST", "/v1/plans", "start_time", "soon"), ("POST", "/v1/plans", "colour", "red"),
)  # fmt: skip
"""Method, path, parameter and value."""
NO_TASKS = ("{", "", '{"a": NaN}', '{"a": 1, "a": 2}', "text", "large", "key", "zip")
"""Bodies that are no JSON, and what else is wrong with a request before its body is looked at."""
PAGED = ("plans", "scenes", "webhooks", "studies")

who, which = st.integers(0, 31), st.integers(0, 23)
"""Choose among what there is, however much that is; the smallest is the simplest."""


@dataclass
class InterfaceFigures:
    """What was tried, and what came of it."""

    examples: int = 0
    steps: int = 0
    restarts: int = 0
    statuses: Counter[int] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)

    def __add__(self, other: InterfaceFigures) -> InterfaceFigures:
        return InterfaceFigures(
            self.examples + other.examples,
            self.steps + other.steps,
            self.restarts + other.restarts,
            self.statuses + other.statuses,
            self.faults + other.faults,
        )


class InterfaceMachine(RuleBasedStateMachine):
    """One life of a service among several owners. Every answer is foretold by the model."""

    service: OwnService
    figures: InterfaceFigures

    def __init__(self) -> None:
        super().__init__()
        self.service.begin_anew()
        self.world = World()
        self.figures.examples += 1
        self.answered: dict[str, tuple[str, str]] = {}
        """The newest answer to whoever looked at an address, and its ETag."""
        for owner, scope in (("mes", "write"), ("other", "write"), ("it", "admin"), ("mes", "read")):
            self.issue(owner, scope)
        self.admin = self.world.keys[2]

    def teardown(self) -> None:
        self.service.end()

    # Asking, and what holds of every answer.

    def ask(
        self,
        key: Key | None,
        method: str,
        path: str,
        *statuses: int,
        needs: str = "read",
        thing: Thing | None = None,
        names: str | None = None,
        **request: Any,
    ) -> httpx.Response | None:
        """Send a request and judge the answer; None if it was one that every request of this caller has.

        Args:
            key: of the caller.
            method: of the request.
            path: of the request.
            statuses: one of which it must have, if the caller may ask for that.
            needs: the scope without which nobody may.
            thing: what it is about: who does not see it must be told that it is not there.
            names: what a refusal must name.
            request: the rest of it.
        """
        refusal = None
        if key is None or not key.opens:
            refusal = (401, 429)
        elif not key.may(needs):
            refusal = (403,)
        elif thing is not None and (thing.gone or not key.sees(thing.owner)):
            refusal = (404,)
        answer = self.service.ask(method, path, None if key is None else key.text, **request)
        self.figures.statuses[answer.status_code] += 1
        said = f"{method} {path} {request} of {key}: {answer.status_code} {answer.text[:500]}"
        assert answer.status_code in (refusal or statuses), f"not {refusal or statuses}: {said}"
        if answer.status_code >= 400:
            assert answer.headers["content-type"] == PROBLEM, said
            problem = answer.json()
            assert problem["status"] == answer.status_code, said
            assert problem["title"], said
            if names is not None and not refusal:
                pointers = [error["pointer"] for error in problem.get("errors", [])]
                assert names in pointers or (not pointers and names in problem["detail"]), f"{names} not named: {said}"
        assert "x-request-id" in answer.headers, said
        if key is not None and key.opens and method != "GET" and path != "/v1/tasks/check":
            target = answer.headers.get("location", path.partition("?")[0])
            entry = {"action": method, "target": target, "status": answer.status_code}
            self.world.audit.append({**entry, "key_id": key.id, "owner": key.owner})
        return None if refusal else answer

    def key(self, number: int) -> Key:
        """Return a key that opens something, or now and then any."""
        opening = [key for key in self.world.keys if key.opens or number % 4 == 3]
        return opening[number // 4 % len(opening)]

    def pick(self, things: Sequence[T], key: Key, number: int) -> T | Thing:
        """Return one of the caller's own things, or of all that were ever there."""
        own = [thing for thing in things if thing.owner == key.owner and not thing.gone]
        found = own if own and number % 4 else things
        return found[number // 4 % len(found)] if found else NOBODY

    def look(self, key: Key, path: str, thing: Thing) -> Any:
        """Look at something twice: what is as it was is not sent again."""
        answer = self.ask(key, "GET", path, 200, thing=thing)
        if answer is None:
            return None
        tag = self.tag_of(path, answer)
        again = self.ask(key, "GET", path, 304, headers={"If-None-Match": f'"other", {tag}'})
        assert again is not None
        assert (again.content, again.headers["etag"]) == (b"", tag)
        self.ask(key, "GET", path, 200, headers={"If-None-Match": '"other"'})
        return answer.json()

    def tag_of(self, path: str, answer: httpx.Response) -> str:
        """Return the ETag of an answer: that of the answer before if both are the same, and another one if not."""
        tag, before = answer.headers["etag"], self.answered.get(path)
        assert before is None or (before[0] == answer.text) == (before[1] == tag), f"{path}: {before} {tag}"
        self.answered[path] = answer.text, tag
        return tag

    def notice(self, plan: Plan) -> None:
        """Look at a plan to which something has just happened."""
        answer = self.ask(self.admin, "GET", f"/v1/plans/{plan.id}", 200, thing=plan)
        assert answer is not None
        self.tag_of(f"/v1/plans/{plan.id}", answer)

    # Keys.

    def issue(self, owner: str, scope: str, expires_us: int | None = None) -> None:
        made = self.service.keys.issue(owner, Scope(scope), expires_us)
        self.world.keys.append(Key(made.id, made.text, owner, scope, opens=expires_us is None))

    def issue_key(self, number: int) -> None:
        owner, scope = ("mes", "other", "third")[number % 3], SCOPES[number // 3 % 2]
        self.issue(owner, scope, now_us() - 1 if number % 4 == 3 else None)

    def revoke_key(self, number: int) -> None:
        key = self.key(number)
        if key is not self.admin:
            known = {record.id: record.revoked_us for record in self.service.keys.all()}
            assert self.service.keys.revoke(key.id) == (known[key.id] is None)
            key.opens = False

    def come_without_a_key(self, _: int, number: int) -> None:
        path = ("/v1/plans", "/v1/cells", "/metrics", "/v1/audit", "/v1/capabilities")[number % 5]
        self.ask(None, "GET", path)
        self.service.ask("GET", "/livez").raise_for_status()

    # Plans.

    def post_simple_plan(self, caller: int, number: int) -> None:
        kind, name = ("lift", "pile", "seen")[number % 3], NAMES[number % len(NAMES)]
        self.post_plan(caller, kind, name, None, 0, later=False, key=None, webhook=0, scene=number)

    @rule(
        caller=who,
        kind=st.sampled_from(["lift", "pile", "seen", "station"]),
        name=st.sampled_from(NAMES),
        master=st.sampled_from(NAMES),
        priority=st.sampled_from([0, 0, 9]),
        later=st.sampled_from([False, False, False, True]),
        key=st.sampled_from([None, "a", "b"]),
        webhook=which,
        scene=which,
    )
    def post_plan(
        self,
        caller: int,
        kind: str,
        name: str | None,
        master: str | None,
        priority: int,
        later: bool,
        key: str | None,
        webhook: int,
        scene: int,
    ) -> None:
        holder, world = self.key(caller), self.world
        seen = self.pick(world.scenes, holder, scene)
        body, fits, pointer = self.task_of(kind, holder, seen, name)
        order = {"priority": priority, "work_master": master, "start_time": LATER if later else None}
        named = self.pick(world.webhooks, holder, webhook) if webhook % 3 == 2 else None
        if named is not None:
            order["webhook"] = named.id
            # Not an administrator's either, of another owner.
            usable = not named.gone and named.owner == holder.owner
            fits, pointer = (fits, pointer) if usable else (False, "/query/webhook")
        params = {name: value for name, value in order.items() if value is not None}
        headers = {} if key is None else {"Idempotency-Key": key}
        known = world.plan_of_key.get((holder.owner, key or "")) if key else None
        statuses, names = (202,), None
        if known is not None and not known[0].gone:
            if known[1] != body:
                statuses, names = (422,), None if fits else pointer
        elif not fits:
            statuses, names = (422,), pointer
        elif world.no_room(holder.owner, delayed=later):
            statuses = (429,)
        else:
            known = None
        request = {"json": body, "params": params, "headers": headers}
        answer = self.ask(holder, "POST", "/v1/plans", *statuses, needs="write", names=names, **request)
        if answer is None or answer.status_code != 202:
            assert answer is None or answer.status_code != 429 or int(answer.headers["retry-after"]) > 0
            return
        told = answer.json()
        assert answer.headers["location"] == told["links"]["self"] == f"/v1/plans/{told['id']}"
        if known is not None:
            assert told["id"] == known[0].id
            return
        scene_id = seen.id if kind == "seen" else None
        made = Plan(told["id"], holder.owner, told["created_at"], kind=body["kind"], external_id=name)
        made.work_master, made.priority, made.scene_id = master, priority, scene_id
        made.start_time = LATER if later else None
        assert told["id"] not in {plan.id for plan in world.plans}
        world.accept(made, None if named is None else named.id)
        if key is not None:
            world.plan_of_key[holder.owner, key] = made, body
        assert known_by(told, world.told(made)) == world.told(made)
        if name is not None:
            asked = {"name": name[:3].upper()}
            found = [plan.id for plan in listed(world.plans, holder) if _holds(plan, asked)]
            self.turn_pages(holder, "plans", found, 200, asked)

    def task_of(self, kind: str, holder: Key, scene: Thing, name: str | None) -> tuple[Any, bool, str]:
        """Return a task, whether it can be begun, and else what is wrong with it."""
        named = {} if name is None else {"external_id": name}
        if kind == "seen":
            body = {member: value for member, value in SEEN.items() if member != "external_id"}
            return {**body, "scene_id": scene.id, **named}, not scene.gone and holder.sees(scene.owner), "/scene_id"
        if kind == "station":
            body = task("pb1.json", **IN_STATION, cell=STATION)
            body.pop("external_id", None)
            return {**body, **named}, self.world.station_of(holder.owner) is not None, "/cell"
        body = task("ab1.json" if kind == "lift" else "domino_pile.json")
        body.pop("external_id", None)
        return {**body, **named}, True, ""

    def post_bad_task(self, caller: int, number: int) -> None:
        body, pointer = list(BAD_TASKS.values())[number // 2 % len(BAD_TASKS)]
        if number % 2:
            answer = self.ask(self.key(caller), "POST", "/v1/tasks/check", 200, json=body)
            assert answer is None or pointer in [error["pointer"] for error in answer.json()["errors"]]
        else:
            self.ask(self.key(caller), "POST", "/v1/plans", 422, needs="write", names=pointer, json=body)

    def post_no_task(self, caller: int, number: int) -> None:
        what = NO_TASKS[number % len(NO_TASKS)]
        key, request, status = self.key(caller), {"content": what, "headers": JSON}, 400
        if what == "text":
            request, status = {"content": "{}", "headers": {"Content-Type": "text/plain"}}, 415
        elif what == "large":
            request, status = {"json": {"kind": "x" * LIMITS["max_body_bytes"]}}, 413
        elif what == "key":
            request = {"json": task(), "headers": {"Idempotency-Key": "two words"}}
        elif what == "zip":
            request, status = {"content": "{}", "headers": {**JSON, "Content-Encoding": "gzip"}}, 415
        names = "Idempotency-Key" if what == "key" else None
        for path in ("/v1/plans", "/v1/studies"):
            self.ask(key, "POST", path, status, needs="write", names=names, **request)

    def give_bad_parameter(self, caller: int, number: int) -> None:
        method, path, name, value = BAD_QUERIES[number % len(BAD_QUERIES)]
        more = {} if method == "GET" else {"json": task(), "needs": "write"}
        self.ask(self.key(caller), method, path, 422, names=f"/query/{name}", params={name: value}, **more)

    def give_foreign_token(self, caller: int, number: int) -> None:
        kind, token = PAGED[number % 4], ("", "x", "MTIz", "é", "MS0w")[number % 5]
        self.ask(self.key(caller), "GET", f"/v1/{kind}", 400, names="page_token", params={"page_token": token})

    def look_at_plan(self, caller: int, number: int) -> None:
        key = self.key(caller)
        plan = self.pick(self.world.plans, key, number)
        told = self.look(key, f"/v1/plans/{plan.id}", plan)
        if told is not None:
            assert isinstance(plan, Plan)
            assert known_by(told, self.world.told(plan)) == self.world.told(plan)
            assert (told["error"] is None) == (plan.state != "failed")
            assert (told["finished_at"] is None) == (not plan.done)

    def look_into_plan(self, caller: int, number: int) -> None:
        key = self.key(caller)
        plan = self.pick(self.world.plans, key, number)
        document = plan.document if isinstance(plan, Plan) else None
        path = f"/v1/plans/{plan.id}"
        answer = self.ask(key, "GET", f"{path}/document", 404 if document is None else 200, thing=plan)
        if answer is not None and document is not None:
            assert answer.content == document
            assert hashlib.sha256(document).hexdigest() in answer.headers["etag"]
            tag = answer.headers["etag"].removeprefix("W/")
            self.ask(key, "GET", f"{path}/document", 304, headers={"If-None-Match": tag})
        view = self.ask(key, "GET", f"{path}/view", 307, thing=plan)
        assert view is None or plan.id in view.headers["location"]
        self.ask(key, "GET", f"{path}/program.zip", 422, thing=None, names="/query/target")
        # What was made up is no plan that a robot may run.
        missing = 404 if document is None else 409
        self.ask(key, "GET", f"{path}/program.zip", missing, thing=plan, params={"target": "csv"})
        if isinstance(plan, Plan) and plan.done:
            events = self.ask(key, "GET", f"{path}/events", 200, thing=plan)
            assert events is None or f'"state":"{plan.state}"' in events.text.split("event: finished")[1]
        self.ask(key, "GET", f"{path}/events", 400, thing=plan, names="Last-Event-ID", headers={"Last-Event-ID": "9"})

    def cancel_plan(self, caller: int, number: int) -> None:
        key = self.key(caller)
        plan = self.pick(self.world.plans, key, number)
        ended = isinstance(plan, Plan) and plan.done
        answer = self.ask(
            key, "POST", f"/v1/plans/{plan.id}/cancel", 409 if ended else 202, needs="write", thing=plan
        )  # fmt: skip
        if answer is not None and isinstance(plan, Plan) and not ended:
            plan.state = "cancelled"
            assert known_by(answer.json(), self.world.told(plan)) == self.world.told(plan)
            self.notice(plan)

    def delete_plan(self, caller: int, number: int) -> None:
        key = self.key(caller)
        plan = self.pick(self.world.plans, key, number)
        ended = isinstance(plan, Plan) and plan.done
        answer = self.ask(key, "DELETE", f"/v1/plans/{plan.id}", 204 if ended else 409, needs="write", thing=plan)
        if answer is not None and ended:
            plan.gone = True
            for webhook in self.world.webhooks:
                if plan in webhook.told_of and not webhook.gone:
                    webhook.told_of.remove(plan)
                    self.read_deliveries(self.admin, webhook)
            for path in ("", "/document", "/events", "/view"):
                self.ask(key, "GET", f"/v1/plans/{plan.id}{path}", thing=plan)

    @rule(
        caller=who,
        filters=st.fixed_dictionaries(
            {},
            optional={
                "external_id": st.sampled_from(NAMES[1:]),
                "work_master": st.sampled_from(NAMES[1:]),
                "name": st.sampled_from(["jo", "-1%", "GRÖ", "_", "o-1", "0"]),
                "kind": st.sampled_from(["plate_lift", "suction_tool"]),
                "state": st.sampled_from(["queued", "running", "succeeded", "failed", "cancelled"]),
                "outcome": st.sampled_from(["solved", "infeasible"]),
            },
        ),
        since=st.none() | which,
        until=st.none() | which,
        size=st.sampled_from([1, 2, 3, 200]),
    )
    def find_plans(self, caller: int, filters: dict[str, str], since: int | None, until: int | None, size: int) -> None:
        key, asked = self.key(caller), dict(filters)
        for name, number in (("created_from", since), ("created_until", until)):
            if number is not None and self.world.plans:
                asked[name] = self.world.plans[number % len(self.world.plans)].created_at
        wanted = [plan for plan in listed(self.world.plans, key) if _holds(plan, asked)]
        self.turn_pages(key, "plans", [plan.id for plan in wanted], size, asked)

    def turn_pages(self, key: Key, kind: str, ids: Sequence[str], size: int, query: dict[str, str]) -> None:
        """Read a list page by page: each thing is there once, in order, and no page is empty but the only one."""
        token: dict[str, str] = {}
        for page in pages(ids, size):
            params = {"page_size": size, **query, **token}
            answer = self.ask(key, "GET", f"/v1/{kind}", 200, params=params)
            if answer is None:
                return
            told = answer.json()
            assert [each["id"] for each in told[kind]] == list(page), f"{kind} {params} of {key}"
            token = {"page_token": told["next_page_token"]}
        assert token == {"page_token": None}

    # The worker, who is played.

    def working(self, plan: Plan, status: str) -> None:
        jobs, now = workflow_table("sqlite"), now_us() // 1000
        values = {"status": status, "executor_id": "played", "updated_at": now}
        assert self.service.state.database.write(sa.update(jobs).where(jobs.c.workflow_uuid == plan.id).values(values))

    def job_is_begun(self, number: int) -> None:
        waiting = [plan for plan in self.world.plans if plan.waits and not plan.gone]
        if waiting:
            plan = waiting[number % len(waiting)]
            self.working(plan, RUNNING)
            assert self.service.state.plans.store.begin_attempt(plan.id) is not None
            plan.state, plan.attempts = "running", plan.attempts + 1
            self.notice(plan)

    def job_ends(self, number: int) -> None:
        outcome = ("solved", "infeasible", None)[number % 3]
        at_work = [plan for plan in self.world.plans if plan.state == "running" and not plan.gone]
        if not at_work:
            return
        plan, store = at_work[number % len(at_work)], self.service.state.plans.store
        if outcome is None:
            assert store.mark_failed(plan.id, plan.attempts, "fault")
            self.working(plan, FAILED)
            plan.state = "failed"
            self.world.made["fault"] += 1
            return
        content = json.dumps({"schema_version": "1.0", "id": plan.id, "outcome": outcome}).encode()
        packed = PackedDocument(outcome, hashlib.sha256(content).hexdigest(), gzip.compress(content))
        assert store.save_document(plan.id, plan.attempts, packed)
        self.working(plan, SUCCEEDED)
        plan.state, plan.outcome, plan.document = "succeeded", outcome, content
        self.world.made[outcome] += 1
        self.notice(plan)

    def point_is_examined(self, number: int) -> None:
        going_on = [each for each in self.world.studies if not each.gone and each.state == "queued"]
        if going_on:
            study = going_on[number % len(going_on)]
            index = number % study.count
            point = StudyPoint(
                index=index, at=(index,) if study.count == 3 else (index // 5, index % 5), outcome="not_found",
                examined="searched", seconds=0.1, summary="made up",
            )  # fmt: skip
            assert self.service.state.studies.store.add_point(study.id, point)
            study.points.add(index)

    # Scenes, cells and meshes.

    def post_scene(self, caller: int, number: int) -> None:
        key, name = self.key(caller), NAMES[number % 2]
        described = {**SCAN.description, "external_id": name}
        form = SCAN.form() | {"scan": ("scan.json", json.dumps(described).encode(), "application/json")}
        answer = self.ask(key, "POST", "/v1/scenes", 201, needs="write", files=form)
        if answer is None:
            return
        told = answer.json()
        assert answer.headers["location"] == f"/v1/scenes/{told['id']}"
        known = next((scene for scene in self.world.scenes if scene.id == told["id"]), None)
        if known is None:
            known = Scene(told["id"], key.owner, gone=True)
            self.world.scenes.append(known)
        if known.gone:
            # One that was deleted has its id again, of the same scan.
            known.gone, known.created_at, known.body = False, told["created_at"], told
        assert (known.owner, known.body) == (key.owner, told)

    def post_bad_scene(self, caller: int, number: int) -> None:
        what = ("json", "empty", "cell", "nothing", "cut", "part")[number % 6]
        key, form = self.key(caller), SCAN.form()
        described = {**SCAN.description, "cell": "moon_base"} if what == "cell" else SCAN.description
        form["scan"] = ("scan.json", json.dumps({} if what == "empty" else described).encode(), "application/json")
        if what == "cut":
            form["depth"] = ("depth", SCAN.files["depth"][:2000], "image/png")
        if what == "nothing":
            del form["scan"]
        if what == "part":
            form["other"] = ("other", b"x", "image/png")
        names = {"cell": "/cell", "cut": "/depth", "nothing": "", "part": ""}.get(what)
        request = {"json": {}} if what == "json" else {"files": form}
        self.ask(key, "POST", "/v1/scenes", 415 if what == "json" else 422, needs="write", names=names, **request)

    def look_at_scene(self, caller: int, number: int) -> None:
        key = self.key(caller)
        scene = self.pick(self.world.scenes, key, number)
        answer = self.ask(key, "GET", f"/v1/scenes/{scene.id}", 200, thing=scene)
        assert answer is None or (isinstance(scene, Scene) and answer.json() == scene.body)
        picture = self.ask(key, "GET", f"/v1/scenes/{scene.id}/preview.png", 200, thing=scene)
        assert picture is None or picture.headers["content-type"] == "image/png"

    def delete_scene(self, caller: int, number: int) -> None:
        key = self.key(caller)
        scene = self.pick(self.world.scenes, key, number)
        using = [plan for plan in self.world.plans if plan.scene_id == scene.id and not plan.gone and not plan.done]
        answer = self.ask(key, "DELETE", f"/v1/scenes/{scene.id}", 409 if using else 204, needs="write", thing=scene)
        if answer is not None and using:
            assert any(plan.id in answer.json()["detail"] for plan in using)
        elif answer is not None:
            scene.gone = True

    def post_cell(self, caller: int, number: int) -> None:
        key, world, content = self.key(caller), self.world, number % 2
        mine = [cell for cell in world.cells if cell.owner == key.owner]
        known = next((cell for cell in mine if cell.content == content), None)
        found = known is not None and not known.gone
        described = station(gravity=[0, 0, (-9.81, -9.8)[content]])
        answer = self.ask(key, "POST", "/v1/cells", 200 if found else 201, needs="write", json=described)
        if answer is None:
            return
        told = answer.json()
        if known is None:
            known = Cell(told["id"], key.owner, content=content, version=len(mine) + 1)
            assert known.id not in {cell.id for cell in world.cells}
            world.cells.append(known)
        known.gone, known.posted = False, 1 + max(cell.posted for cell in world.cells)
        expected = {"id": known.id, "name": STATION, "version": known.version}
        assert known_by(told, expected) == expected
        self.ask_what_the_name_means(key)

    def post_bad_cell(self, caller: int, number: int) -> None:
        what = ("shipped", "member", "type")[number % 3]
        key = self.key(caller)
        bad = {"shipped": station(name=sorted(known_cells())[0]), "member": station(colour="red")}
        request = {"content": b"x", "headers": {"Content-Type": "image/png"}} if what == "type" else {"json": bad[what]}
        status = {"shipped": 409, "member": 422, "type": 415}[what]
        for path in ("/v1/cells", "/v1/surveys"):
            names = "/colour" if what == "member" else None
            self.ask(key, "POST", path, status, needs="write", names=names, **request)

    def look_at_cell(self, caller: int, number: int, *, delete: bool = False) -> None:
        key, by_name = self.key(caller), number % 3 == 2
        cell = self.pick(self.world.cells, key, number)
        meant = (self.world.station_of(key.owner) or NOBODY) if by_name else cell
        path = f"/v1/cells/{STATION if by_name else cell.id}"
        if delete:
            if self.ask(key, "DELETE", path, 204, needs="write", thing=meant) is not None:
                meant.gone = True
                self.ask_what_the_name_means(key)
            return
        answer = self.ask(key, "GET", path, 200, thing=meant)
        assert answer is None or answer.json()["id"] == meant.id
        files = self.ask(key, "GET", f"{path}/files.zip", 200, thing=meant)
        assert files is None or files.content[:2] == b"PK"

    def ask_what_the_name_of_a_cell_means(self, caller: int, _: int) -> None:
        self.ask_what_the_name_means(self.key(caller))

    def ask_what_the_name_means(self, key: Key) -> None:
        body = task("pb1.json", **IN_STATION, cell=STATION)
        answer = self.ask(key, "POST", "/v1/tasks/check", 200, json=body)
        if answer is not None:
            meant, told = self.world.station_of(key.owner), answer.json()
            assert told["accepted"] == (meant is not None)
            assert meant is None or told["task"]["cell"] == meant.id

    def post_mesh(self, caller: int, _: int, *, good: bool = True) -> None:
        key = self.key(caller)
        content = _TETRAHEDRON if good else next(iter(meshes()))[1][:2000]
        request = {"content": content, "headers": {"Content-Type": "model/obj"}}
        answer = self.ask(key, "POST", "/v1/meshes", 201 if good else 422, needs="write", names=None, **request)
        if answer is not None and good:
            told = self.world.meshes.setdefault(answer.json()["id"], answer.json())
            assert answer.json() == told
            again = self.ask(key, "GET", told["links"]["self"], 200)
            assert again is not None
            assert again.json() == told

    # Webhooks.

    def register_webhook(self, caller: int, number: int) -> None:
        key, url, plans = self.key(caller), f"https://example.com/{number}", ("all", "named")[number % 2]
        own = [each for each in self.world.webhooks if each.owner == key.owner and not each.gone]
        full = len(own) >= MAX_WEBHOOKS
        request = {"json": {"url": url, "plans": plans}}
        answer = self.ask(key, "POST", "/v1/webhooks", 409 if full else 201, needs="write", **request)
        if answer is not None and not full:
            told = answer.json()
            webhook = Webhook(told["id"], key.owner, told["created_at"], url=url, plans=plans)
            webhook.secrets.add(told["secret"])
            assert answer.headers["location"] == f"/v1/webhooks/{webhook.id}"
            self.world.webhooks.append(webhook)

    def register_bad_webhook(self, caller: int, number: int) -> None:
        body, pointer = list(BAD_WEBHOOKS.values())[number % len(BAD_WEBHOOKS)]
        self.ask(self.key(caller), "POST", "/v1/webhooks", 422, needs="write", names=pointer, json=body)

    def look_at_webhook(self, caller: int, number: int) -> None:
        key = self.key(caller)
        webhook = self.pick(self.world.webhooks, key, number)
        answer = self.ask(key, "GET", f"/v1/webhooks/{webhook.id}", 200, thing=webhook)
        if answer is not None:
            assert isinstance(webhook, Webhook)
            told = {"url": webhook.url, "plans": webhook.plans, "secret": None, "disabled_at": None}
            assert known_by(answer.json(), told) == told
            self.read_deliveries(key, webhook)
        else:
            self.ask(key, "GET", f"/v1/webhooks/{webhook.id}/deliveries", thing=webhook)

    def read_deliveries(self, key: Key, webhook: Webhook) -> None:
        sent = self.ask(key, "GET", f"/v1/webhooks/{webhook.id}/deliveries", 200, params={"page_size": 200})
        assert sent is not None
        waiting = [(each["plan_id"], each["state"]) for each in sent.json()["deliveries"]]
        assert waiting == [(plan.id, "waiting") for plan in reversed(webhook.told_of)]

    def rotate_webhook(self, caller: int, number: int) -> None:
        key = self.key(caller)
        webhook = self.pick(self.world.webhooks, key, number)
        answer = self.ask(key, "POST", f"/v1/webhooks/{webhook.id}/rotate", 200, needs="write", thing=webhook)
        if answer is not None:
            assert isinstance(webhook, Webhook)
            secret = answer.json()["secret"]
            assert secret not in webhook.secrets
            webhook.secrets.add(secret)

    def delete_webhook(self, caller: int, number: int) -> None:
        key = self.key(caller)
        webhook = self.pick(self.world.webhooks, key, number)
        if self.ask(key, "DELETE", f"/v1/webhooks/{webhook.id}", 204, needs="write", thing=webhook) is not None:
            webhook.gone = True

    # Studies.

    def post_study(self, caller: int, number: int) -> None:
        holder, world, name = self.key(caller), self.world, NAMES[number % len(NAMES)]
        axes, key = ([X], [X, MANY])[number % 2], (None, None, "a")[number % 3]
        body = {"task": task(external_id="of a point"), "axes": axes, "external_id": name}
        known = world.study_of_key.get((holder.owner, key or "")) if key else None
        unfinished = [each for each in world.studies if not each.gone and each.state == "queued"]
        status = 202
        if known is not None and not known[0].gone:
            status = 202 if known[1] == body else 422
        else:
            known = None
            status = 429 if len(unfinished) >= MAX_STUDIES else 202
        request = {"json": body, "headers": {} if key is None else {"Idempotency-Key": key}}
        answer = self.ask(holder, "POST", "/v1/studies", status, needs="write", **request)
        if answer is None or status != 202:
            return
        told = answer.json()
        if known is not None:
            assert told["id"] == known[0].id
            return
        made = Study(told["id"], holder.owner, told["created_at"], count=15 if axes[1:] else 3)
        made.external_id = name
        world.studies.append(made)
        if key is not None:
            world.study_of_key[holder.owner, key] = made, body
        self.look_at_that_study(holder, made)

    def post_bad_study(self, caller: int, number: int) -> None:
        body, pointer = list(BAD_STUDIES.values())[number % len(BAD_STUDIES)]
        self.ask(self.key(caller), "POST", "/v1/studies", 422, needs="write", names=pointer, json=body)

    def look_at_study(self, caller: int, number: int) -> None:
        key = self.key(caller)
        self.look_at_that_study(key, self.pick(self.world.studies, key, number))

    def look_at_that_study(self, key: Key, study: Thing) -> None:
        told = self.look(key, f"/v1/studies/{study.id}", study)
        found = self.ask(key, "GET", f"/v1/studies/{study.id}/map", 200, thing=study)
        if told is not None and found is not None:
            assert isinstance(study, Study)
            expected = {
                "id": study.id, "state": study.state, "count": study.count, "known": len(study.points),
                "external_id": study.external_id, "done": study.state == "cancelled", "created_at": study.created_at,
            }  # fmt: skip
            assert known_by(told, expected) == expected
            assert [point["index"] for point in found.json()["points"]] == sorted(study.points)

    def cancel_study(self, caller: int, number: int) -> None:
        key = self.key(caller)
        study = self.pick(self.world.studies, key, number)
        ended = isinstance(study, Study) and study.state == "cancelled"
        status = 409 if ended else 202
        answer = self.ask(key, "POST", f"/v1/studies/{study.id}/cancel", status, needs="write", thing=study)
        if answer is not None and isinstance(study, Study):
            study.state = "cancelled"

    def delete_study(self, caller: int, number: int) -> None:
        key = self.key(caller)
        study = self.pick(self.world.studies, key, number)
        ended = isinstance(study, Study) and study.state == "cancelled"
        status = 204 if ended else 409
        answer = self.ask(key, "DELETE", f"/v1/studies/{study.id}", status, needs="write", thing=study)
        if answer is not None and ended:
            study.gone = True

    def plan_point(self, caller: int, number: int) -> None:
        key, world, index = self.key(caller), self.world, (0, 1, 2, 15)[number // 3 % 4]
        study = self.pick(world.studies, key, number)
        made = study.plans.get(index) if isinstance(study, Study) else None
        if made is not None and made.gone:
            made = None
        if isinstance(study, Study) and index >= study.count:
            status = 404
        elif made is not None:
            status = 200 if made.done else 202
        else:
            status = 429 if world.no_room(study.owner, delayed=False) else 202
        path = f"/v1/studies/{study.id}/points/{index}/plan"
        answer = self.ask(key, "POST", path, status, needs="write", thing=study)
        if answer is None or status in (404, 429):
            return
        told = answer.json()
        if made is not None:
            assert told["id"] == made.id
        elif isinstance(study, Study):
            made = Plan(told["id"], study.owner, told["created_at"], external_id="of a point")
            world.accept(made)
            study.plans[index] = made
        assert made is not None
        assert known_by(told, world.told(made)) == world.told(made)

    # Everything together.

    def list_things(self, caller: int, number: int) -> None:
        key, kind, size = self.key(caller), PAGED[1:][number % 3], (1, 2, 200)[number // 3 % 3]
        ids = [thing.id for thing in listed(getattr(self.world, kind), key)]
        self.turn_pages(key, kind, ids, size, {})

    def list_cells(self, caller: int, _: int) -> None:
        key, shipped = self.key(caller), sorted(known_cells())
        answer = self.ask(key, "GET", "/v1/cells", 200)
        if answer is None:
            return
        told = answer.json()["cells"]
        assert [each["id"] for each in told[: len(shipped)]] == shipped
        own = {each["id"]: each["version"] for each in told[len(shipped) :]}
        there = [cell for cell in self.world.cells if not cell.gone and key.sees(cell.owner)]
        assert own == {cell.id: cell.version for cell in there}
        assert list(own.values()) == sorted(own.values(), reverse=True)
        able = self.ask(key, "GET", "/v1/capabilities", 200)
        assert able is not None
        meant = [] if self.world.station_of(key.owner) is None else [STATION]
        assert able.json()["cells"] == sorted(able.json()["cell_limits"]) == sorted([*shipped, *meant])

    def read_audit(self, caller: int, number: int) -> None:
        key, size = self.key(caller), (1, 5, 200)[number % 3]
        answer = self.ask(key, "GET", "/v1/audit", 200, needs="admin", params={"page_size": size})
        if answer is not None:
            names = ("action", "target", "status", "key_id", "owner")
            entries = [known_by(entry, names) for entry in answer.json()["entries"]]
            assert entries == self.world.audit[-size:][::-1]
            assert (answer.json()["next_before"] is None) == (len(self.world.audit) <= size)

    def ask_for_the_head_only(self, caller: int, number: int) -> None:
        key, kind = self.key(caller), PAGED[number % 4]
        thing = self.pick(getattr(self.world, kind), key, number)
        for path in (f"/v1/{kind}", f"/v1/{kind}/{thing.id}"):
            whole, head = (self.service.ask(method, path, key.text) for method in ("GET", "HEAD"))
            told, kept = (
                [each for each in given.headers.items() if each[0] != "x-request-id"] for given in (whole, head)
            )
            assert (head.status_code, head.content, kept) == (whole.status_code, b"", told)

    @initialize()
    def everybody_has_something(self) -> None:
        for caller in (0, 4, 8):
            for number, post in enumerate((self.register_webhook, self.post_simple_plan, self.post_scene)):
                post(caller, number)
        self.post_study(0, 0)
        self.job_is_begun(0)
        self.job_ends(0)

    @rule(caller=who, what=st.integers(0, 8), number=which)
    def a_thing_is_posted(self, caller: int, what: int, number: int) -> None:
        posts = (
            self.post_simple_plan, self.post_scene, self.post_study, self.register_webhook, self.post_cell,
            self.plan_point, self.post_mesh,
        )  # fmt: skip
        posts[what % len(posts)](caller, number)

    @rule(caller=who, what=st.integers(0, 7), number=which)
    def look_at_something(self, caller: int, what: int, number: int) -> None:
        looks = (
            self.look_at_plan, self.look_into_plan, self.look_at_study, self.look_at_scene, self.look_at_webhook,
            self.look_at_cell, self.ask_what_the_name_of_a_cell_means,
        )  # fmt: skip
        looks[what % len(looks)](caller, number)

    @rule(caller=who, what=st.integers(0, 4), number=which)
    def change_something(self, caller: int, what: int, number: int) -> None:
        changes = self.cancel_plan, self.cancel_study, self.rotate_webhook
        changes[what % len(changes)](caller, number)

    @rule(caller=who, what=st.integers(0, 6), number=which)
    def delete_something(self, caller: int, what: int, number: int) -> None:
        deletions = (
            self.delete_plan, self.delete_study, self.delete_scene, self.delete_webhook,
            partial(self.look_at_cell, delete=True),
        )  # fmt: skip
        deletions[what % len(deletions)](caller, number)

    @rule(caller=who, what=st.integers(0, 3), number=which)
    def list_something(self, caller: int, what: int, number: int) -> None:
        lists = self.list_things, self.list_cells, self.read_audit, self.ask_for_the_head_only
        lists[what](caller, number)

    @rule(caller=who, what=st.integers(0, 9), number=which)
    def ask_for_what_cannot_be(self, caller: int, what: int, number: int) -> None:
        refused = (
            self.come_without_a_key, self.post_bad_task, self.post_no_task, self.give_bad_parameter,
            self.give_foreign_token, self.post_bad_scene, self.post_bad_cell, self.register_bad_webhook,
            self.post_bad_study, partial(self.post_mesh, good=False),
        )  # fmt: skip
        refused[what](caller, number)

    @rule(caller=who, what=st.integers(0, 4), number=which)
    def worker_does_something(self, caller: int, what: int, number: int) -> None:
        (self.job_is_begun, self.job_ends, self.point_is_examined)[what % 3](number)

    @rule(caller=who, what=st.integers(0, 2), number=which)
    def operator_does_something(self, caller: int, what: int, number: int) -> None:
        (self.issue_key, self.revoke_key, self.restart)[what](number)

    def restart(self, _: int) -> None:
        self.service.restart()
        self.figures.restarts += 1

    @invariant()
    def everything_is_as_it_was_accepted(self) -> None:
        self.figures.steps += 1
        world = self.world
        answer = self.ask(self.admin, "GET", "/v1/plans", 200, params={"page_size": 200})
        assert answer is not None
        expected = [world.told(plan) for plan in listed(world.plans, self.admin)]
        assert [known_by(told, TOLD) for told in answer.json()["plans"]] == expected
        kind = PAGED[1:][self.figures.steps % 3]
        ids = [thing.id for thing in listed(getattr(world, kind), self.admin)]
        self.turn_pages(self.admin, kind, ids, 200, {})

    @invariant()
    def everything_is_counted(self) -> None:
        if self.figures.steps % 5:
            return
        self.service.ask("GET", "/readyz").raise_for_status()
        answer = self.ask(self.admin, "GET", "/metrics", 200)
        assert answer is not None
        there = [plan for plan in self.world.plans if not plan.gone]
        counted = {
            'liftwright_jobs{state="queued"}': sum(plan.waits for plan in there),
            'liftwright_jobs{state="delayed"}': sum(plan.state == "queued" and not plan.waits for plan in there),
            'liftwright_jobs{state="running"}': sum(plan.state == "running" for plan in there),
            'liftwright_failed_jobs_total{why="fault"}': self.world.made["fault"],
        }
        for outcome in ("solved", "infeasible"):
            counted[f'liftwright_documents{{outcome="{outcome}"}}'] = sum(plan.outcome == outcome for plan in there)
            counted[f'liftwright_documents_made_total{{outcome="{outcome}"}}'] = self.world.made[outcome]
        told = dict(re.findall(r"^(liftwright_\w+\{[^}]*\}) (\S+)$", answer.text, re.MULTILINE))
        assert {name: float(told.get(name, 0)) for name in counted} == counted


TOLD = tuple(World().told(Plan("", "", gone=True)))
"""The members of a plan that the model foretells."""
_TETRAHEDRON = b"v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def _holds(plan: Plan, asked: dict[str, str]) -> bool:
    """Tell whether all that a query says holds of a plan."""
    names = [name.lower() for name in (plan.external_id, plan.work_master) if name is not None]
    holds: dict[str, Callable[[str], bool]] = {
        "external_id": lambda value: plan.external_id == value,
        "work_master": lambda value: plan.work_master == value,
        "kind": lambda value: plan.kind == value,
        "state": lambda value: plan.state == value,
        "outcome": lambda value: plan.outcome == value,
        "name": lambda value: any(value.lower() in name for name in names) or plan.id.startswith(value.lower()),
        "created_from": lambda value: plan.created_at >= value,
        "created_until": lambda value: plan.created_at < value,
    }
    return all(holds[name](value) for name, value in asked.items())


@contextmanager
def explored(folder: Path) -> Iterator[type[InterfaceMachine]]:
    """Have a service to explore, and yield what does it."""
    with sparing_repeats():

        class Machine(InterfaceMachine):
            service, figures = OwnService(folder, **LIMITS), InterfaceFigures()

        yield Machine


def explore(machine: type[InterfaceMachine], examples: int, steps: int, number: int | None = None) -> None:
    """Explore the interface so many times, by so many steps at most; `number` is what these are drawn by."""
    phases = [Phase.generate] if number is not None else [Phase.generate, Phase.shrink]
    effort = settings(
        max_examples=examples, stateful_step_count=steps, deadline=None, database=None, phases=phases,
        derandomize=number is None, suppress_health_check=list(HealthCheck), print_blob=False,
    )  # fmt: skip
    run_state_machine_as_test(machine if number is None else seed(number)(machine), settings=effort)


def explore_alone(examples: int, steps: int, number: int) -> InterfaceFigures:
    """Explore the interface of a service of its own; what breaks a promise is told, and ends it."""
    with tempfile.TemporaryDirectory() as folder, explored(Path(folder)) as machine:
        try:
            explore(machine, examples, steps, number)
        except Exception as fault:  # noqa: BLE001 - whatever it is, the model has not foretold it
            machine.figures.faults.append(str(fault)[:500])
        return machine.figures
