"""Whether cup and fingers hold what they carry along a timed motion, and with which forces.

An object hangs on the cup alone: the wrench of the suction contact follows from its weight and its inertia. The tool
is in one hand or in two: the fingers squeeze it with a commanded force, and bear its weight and inertia and the
reaction of the suction contact. Where both hands hold the tool, each bears the share of the load with which both are
equally far from their nearest limit: that of friction, or that of what one hand may carry.

How far limits are away is told as a reserve: the largest share of all force limits (the cup's force, friction and
stiffness, the fingers' friction, what they may press beyond the squeeze, what a hand may carry) that could be missing
with the load still borne. The squeeze is commanded, and no limit. See docs/grip-model.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planners.errors import LiftwrightError
from planners.geometry.pose import Array, Transform
from planners.geometry.wrench import in_axes, wrench_about
from planners.graph.rejections import Rejection
from planners.motion.spacing import spaced, spent_on_the_way
from planners.plan.segment import SegmentKind
from planners.regrasp.statics.finger_forces import FingerForces, least_squeeze, squeezed
from planners.regrasp.statics.mass_properties import MassProperties
from planners.regrasp.statics.resting import RestingPoints, resting_points
from planners.regrasp.suction.suction_hold import SuctionLimit, cup_uses, least_margin
from planners.regrasp.tool_segment import ExertedForce, HeldReserve, ToolContactSet, ToolHold, ToolSegment
from planners.scene.body import Body
from planners.scene.placements import still_solids
from planners.scene.suction_tool import TOOL_NAME
from planners.scene.tool_scene import SuctionToolScene

SUDDEN = 2.0
"""How much more a load asks of what gives way like a spring, as fingers and cup do, when it comes at once [1]."""
_SLOWEST = 32.0
"""Factors of time beyond which slowing down is not tried: inertia is a thousandth of what it was."""
_SLOWING_STEPS = 12
_SHARINGS = 40
"""Halvings of the interval in which the first hand's share of the load lies."""
_NO_ROOM = 1e-9
"""Stands for nothing that a finger may press beyond the squeeze [N]."""
_CUP_WORDS = tuple(
    {
        SuctionLimit.PULL: "cup: pull",
        SuctionLimit.SLIP: "cup: friction",
        SuctionLimit.TWIST: "cup: friction against twisting",
        SuctionLimit.PEEL: "cup: bending",
        SuctionLimit.PUSH: "cup: it only pulls",
    }[limit]
    for limit in SuctionLimit
)
"""What gives way, as told in the document, in the order of the limits."""
_CUP_KINDS = (SegmentKind.ATTACH, SegmentKind.DETACH)
"""Kinds in which the object rests though it is on the cup."""
UNGRIPPED = "The tool needs a harder squeeze than fingers may exert."
"""Why a hand does not hold."""
PRESSED = "A finger would press harder than grip_force_limit."
"""The same."""
OVERLOADED = (
    "Tool and object ask more of one hand than it may carry: the arm's payload less the hand, or carry_force_limit."
)
"""The same."""
PAD_AXIS_LENGTH = 1e-3
"""An axis of a body whose projection on the pad is shorter is square to the pad [1]."""


class UnheldError(LiftwrightError):
    """Contact forces were asked for where there are none; `rejection` says what gives way."""

    def __init__(self, rejection: Rejection) -> None:
        self.rejection = rejection
        super().__init__(f"{rejection.reason} ({rejection.where})")


@dataclass(frozen=True)
class HoldSettings:
    """How often forces are shown."""

    set_rotation: float = math.radians(1.9)
    """Largest turn of a body between two contact sets [rad]: the document's rule is 2 degrees."""
    set_travel: float = 0.0095
    """Largest way of a centre of mass between two contact sets [m]: the document's rule is 10 mm."""
    set_pause: float = 0.24
    """Longest time between two contact sets while a body is held still [s]: the document's rule is 0.25 s."""
    set_inertia: float = 0.045
    """Part of a body's weight by which its inertia between two contact sets may differ from the mean of what both
    count, weighted by time: the certificate's rule is 0.05."""


@dataclass(frozen=True)
class WorstHold:
    """Where along a motion least is left of what cup and fingers can bear."""

    margin: float
    """Reserve: share of the limits that could be missing, negative where they are exceeded [1]; infinite where nothing
    is held."""
    rejection: Rejection | None
    """What gives way; None where all holds."""


@dataclass(frozen=True, eq=False)
class BorneRates:
    """How fast a path q(s) may be passed for cup and fingers to hold.

    They hold where |d²s/dt²| / `rate` + (ds/dt)² / `squared_speed` is at most 1: what they bear is convex, and of a
    load's inertia one part is proportional to each.
    """

    parameter: Array
    """(n,) s."""
    rate: Array
    """(n,) most d²s/dt² at rest there."""
    squared_speed: Array
    """(n,) most (ds/dt)² at an even pace."""


@dataclass(frozen=True, eq=False)
class _Load:
    """What one body asks for at n samples: its weight, and its inertia at the speed of the motion."""

    poses: Array
    """(n, 4, 4)"""
    centres: Array
    """(n, 3)"""
    weight: Array
    """(6,) about the centre of mass, world axes."""
    inertia: Array
    """(n, 6) likewise."""
    gyration: float
    """The body's largest radius of gyration [m]."""

    def wrenches(self, slowness: Array | None = None) -> Array:
        """Return (n, 6) that must be exerted on the body, about its centre of mass, if time is stretched by (n,)."""
        return -(self.weight + (self.inertia if slowness is None else self.inertia / slowness[:, None] ** 2))


@dataclass(frozen=True, eq=False)
class _Use:
    """To which part one limit could be reduced with its load still borne, at n samples."""

    words: str
    """What would give way, as told in the document."""
    body: str
    """What would be lost."""
    arm: str | None
    """Whose hand it is; None: the cup."""
    stage: str
    """As of rejections: "suction", "grip", "press" or "carry"."""
    used: Array
    """(n,) more than 1 where the load is not borne [1]."""


@dataclass(frozen=True, eq=False)
class _Bearing:
    """What cup and hands exert at n samples."""

    suction: Array
    """(n, 6) of the tool on the object, world axes, about the centre of the lip; zero while the object rests."""
    hands: tuple[FingerForces, ...]
    """Of each hand that bears the tool, TCP axes."""
    uses: tuple[_Use, ...]
    """Of all limits."""

    @property
    def left(self) -> Array:
        """(n,) What is left of the nearest limit [1]."""
        return 1.0 - np.max([each.used for each in self.uses], axis=0)

    @property
    def margin(self) -> float:
        """What is left of the nearest limit at the worst sample."""
        return float(self.left.min())

    @property
    def nearest(self) -> tuple[_Use, int]:
        """The limit that is nearest, and the sample at which it is."""
        use = max(self.uses, key=lambda each: float(each.used.max()))
        return use, int(np.argmax(use.used))

    def reserve(self) -> HeldReserve:
        """Return what is left of all limits along the motion."""
        use, sample = self.nearest
        return HeldReserve(self.left, sample, use.words, use.body)


@dataclass(frozen=True, eq=False)
class _Held:
    """What is asked for during a segment, and who bears it."""

    loads: Mapping[str, _Load]
    """By body."""
    bearing: _Bearing


class HoldStatics:
    """Contact forces of one suction-tool scene."""

    def __init__(self, scene: SuctionToolScene, settings: HoldSettings | None = None) -> None:
        """Take masses and shapes from the scene; nothing is computed yet."""
        self.scene, self.settings = scene, settings or HoldSettings()
        bodies = [scene.tool.body, *(moved.body for moved in scene.objects)]
        self._bodies = {body.name: body for body in bodies}
        self._masses = {body.name: _mass_properties(body) for body in bodies}
        self._fixed = {name: (solid.flat_pieces(), T) for name, solid, T in still_solids(scene.cell)}
        self._fixed |= {body.name: (body.solid.flat_pieces(), body.T_world_body) for body in scene.obstacles}

    def start(self) -> dict[str, Transform]:
        """Return where tool and objects are at the start."""
        return {name: body.T_world_body for name, body in self._bodies.items()}

    def worst(self, segment: ToolSegment, places: Mapping[str, Transform]) -> WorstHold:
        """Return where cup or fingers are nearest to giving way in a segment, looked at every sample.

        Args:
            segment: timed; its contact sets are not read.
            places: where tool and objects are when it begins.
        """
        held = self._held(segment, places)
        return WorstHold(math.inf, None) if held is None else self._worst(segment, places, held)

    def stretch(self, segment: ToolSegment, places: Mapping[str, Transform]) -> float | None:
        """Return the factor, 1 or more, by which a segment's time must be stretched for cup and fingers to hold.

        What they carry swings on them: a motion that sets in faster than that swings asks up to `SUDDEN` times its
        inertia of them. So much is held, whatever the stiffness, which nobody states.

        Returns:
            None where they would not hold however slow it is.
        """
        if not bearers(segment):
            return 1.0
        slowness = self._slowness(segment, self._loads(segment, places))
        return None if slowness is None else float(slowness.max())

    def borne_rates(
        self, along: ToolSegment, places: Mapping[str, Transform], rate: float, squared_speed: float
    ) -> BorneRates | None:
        """Return how fast a path may be passed for cup and fingers to hold, `SUDDEN` times the inertia as in `stretch`.

        Args:
            along: a segment whose times are the path's parameter s.
            places: where tool and objects are when it begins.
            rate: no more d²s/dt² is looked for.
            squared_speed: no more (ds/dt)² is looked for.

        Returns:
            None where they would not hold however slow it is.
        """
        loads = self._loads(along, places)
        # The inertia of what is passed with d²s/dt² = 1 from rest is its momentum at ds/dt = 1.
        momenta = {name: self._momentum(name, along.trajectory.time, load) for name, load in loads.items()}
        speeding, braking = (
            {name: replace(load, inertia=most * momenta[name]) for name, load in loads.items()}
            for most in (-rate, rate)
        )
        even = {name: replace(load, inertia=squared_speed * load.inertia) for name, load in loads.items()}
        factors = []
        for each in (speeding, braking, even):
            factor = self._slowness(along, each)
            if factor is None:
                return None
            factors.append(factor)
        of_rate = np.maximum(factors[0], factors[1])
        return BorneRates(along.trajectory.time, rate / of_rate**2, squared_speed / factors[2] ** 2)

    def _slowness(self, segment: ToolSegment, loads: Mapping[str, _Load]) -> Array | None:
        """Return the factors (n,), 1 or more, by which time must be stretched at samples; None: none would do."""
        low = np.ones(len(segment.trajectory.time))

        def holds(slowness: Array) -> NDArray[np.bool_]:
            return self._bearing(segment, loads, slowness / math.sqrt(SUDDEN)).left >= 0.0

        held, high = holds(low), np.full_like(low, _SLOWEST)
        if held.all():
            return low
        if not holds(high).all():
            return None
        high[held] = 1.0
        for _ in range(_SLOWING_STEPS):
            middle = np.sqrt(low * high)
            held = holds(middle)
            low, high = np.where(held, low, middle), np.where(held, middle, high)
        return high

    def _momentum(self, name: str, parameter: Array, load: _Load) -> Array:
        """Return the momentum (n, 6) of a body whose path is passed at unit speed."""
        between = self._masses[name].momenta(parameter, load.poses)
        return np.concatenate([between[:1], 0.5 * (between[1:] + between[:-1]), between[-1:]])

    def balanced(self, segments: Iterable[ToolSegment]) -> tuple[ToolSegment, ...]:
        """Return the segments of a whole plan with their contact sets and reserves.

        Raises:
            UnheldError: Cup or fingers give way, or an object would tip over where it is put down.
        """
        places = self.start()
        complete = []
        for segment in segments:
            held = self._held(segment, places)
            if held is None:
                complete.append(replace(segment, contact_sets=(), reserve=None))
            else:
                sets = self._contact_sets(segment, places, held)
                complete.append(replace(segment, contact_sets=sets, reserve=held.bearing.reserve()))
            places.update({name: poses[-1] for name, poses in segment.body_poses.items()})
        return tuple(complete)

    def sets(self, segment: ToolSegment, places: Mapping[str, Transform]) -> tuple[ToolContactSet, ...]:
        """Return the contact sets of a segment: of the tool while it is held, of an object while it is on the cup.

        Raises:
            UnheldError: Cup or fingers give way, or an object would tip over where it is put down.
        """
        held = self._held(segment, places)
        return () if held is None else self._contact_sets(segment, places, held)

    def _contact_sets(
        self, segment: ToolSegment, places: Mapping[str, Transform], held: _Held
    ) -> tuple[ToolContactSet, ...]:
        rejection = self._worst(segment, places, held).rejection
        if rejection is not None:
            raise UnheldError(rejection)
        standing = self._standing(segment, places) if segment.kind in _CUP_KINDS else ()
        return tuple(
            contact_set
            for sample in self._samples(segment, held.loads)
            for contact_set in self._sets_at(segment, held.loads, held.bearing, standing, sample)
        )

    # Loads and who bears them.

    def _held(self, segment: ToolSegment, places: Mapping[str, Transform]) -> _Held | None:
        """Return what is borne during a segment; None where no hand bears anything."""
        if not bearers(segment):
            return None
        loads = self._loads(segment, places)
        return _Held(loads, self._bearing(segment, loads))

    def _worst(self, segment: ToolSegment, places: Mapping[str, Transform], held: _Held) -> WorstHold:
        if segment.kind in _CUP_KINDS and self._resting(segment, places)[1] is None:
            assert segment.sucked is not None
            reason = "The object does not stand where the cup takes it or puts it down."
            return WorstHold(-math.inf, Rejection("rest", reason, segment.sucked.name))
        margin = held.bearing.margin
        return WorstHold(margin, self._rejection(segment, held.loads, held.bearing) if margin < 0.0 else None)

    def _loads(self, segment: ToolSegment, places: Mapping[str, Transform]) -> dict[str, _Load]:
        names = [TOOL_NAME] if segment.sucked is None else [TOOL_NAME, segment.sucked.name]
        time = segment.trajectory.time
        loads = {}
        for name in names:
            mass = self._masses[name]
            poses = segment.body_poses.get(name)
            if poses is None:
                poses = np.broadcast_to(places[name], (len(time), 4, 4))
            weight = np.concatenate([mass.mass * self.scene.cell.gravity, np.zeros(3)])
            inertia = mass.inertial_wrenches(time, poses)
            loads[name] = _Load(poses, mass.centres(poses), weight, inertia, mass.gyration)
        return loads

    def _bearing(self, segment: ToolSegment, loads: Mapping[str, _Load], slowness: Array | None = None) -> _Bearing:
        tool = loads[TOOL_NAME]
        lip = tool.poses[:, :3, 3]
        suction, uses = np.zeros((len(lip), 6)), []
        if segment.sucked is not None and segment.kind not in _CUP_KINDS:
            load = loads[segment.sucked.name]
            suction = wrench_about(load.wrenches(slowness), load.centres, lip)
            used = cup_uses(in_axes(tool.poses, suction), self.scene.tool.cup)
            uses = [_Use(words, segment.sucked.name, None, "suction", used[:, k]) for k, words in enumerate(_CUP_WORDS)]
        # The reaction of the object is minus the suction, and the hands exert minus that.
        needed = wrench_about(tool.wrenches(slowness), tool.centres, lip) + suction
        hands = self._hands(segment, needed, tool.poses)
        for hold, forces in zip(bearers(segment), hands, strict=True):
            uses += self._uses(hold, forces)
        return _Bearing(suction, hands, tuple(uses))

    def _hands(self, segment: ToolSegment, needed: Array, tool_poses: Array) -> tuple[FingerForces, ...]:
        """Return the forces of each hand that bears; `needed` is about the lip, world axes."""
        holds = bearers(segment)
        asked = [_about_tcp(hold, needed, tool_poses) for hold in holds]
        if len(holds) == 1:
            return (self._squeezed(holds[0], asked[0]),)
        # What is used of a hand's limits rises with its share of the load and falls with that of the other.
        low, high = np.zeros(len(needed)), np.ones(len(needed))
        for _ in range(_SHARINGS):
            share = 0.5 * (low + high)
            first, second = (
                np.max([use.used for use in self._uses(hold, self._squeezed(hold, part[:, None] * all_of_it))], axis=0)
                for hold, part, all_of_it in zip(holds, (share, 1.0 - share), asked, strict=True)
            )
            low, high = np.where(first < second, share, low), np.where(first < second, high, share)
        share = 0.5 * (low + high)[:, None]
        return self._squeezed(holds[0], share * asked[0]), self._squeezed(holds[1], (1.0 - share) * asked[1])

    def _squeezed(self, hold: ToolHold, asked: Array) -> FingerForces:
        return squeezed(asked, hold.width, self.scene.friction.grip, self.scene.friction.eps, self.scene.squeeze)

    def _uses(self, hold: ToolHold, exerted: FingerForces) -> list[_Use]:
        """Return what is used of a hand: friction, what its fingers can press beyond the squeeze, what it may carry."""
        arm, scene = hold.arm, self.scene
        room = max(scene.finger_limit(arm) - scene.squeeze, _NO_ROOM)
        carried = np.linalg.norm(exerted.forces.sum(axis=1), axis=1) / scene.carry_force_limits[arm]
        return [
            _Use(f"friction of the {arm} fingers", TOOL_NAME, arm, "grip", exerted.slip),
            _Use(
                f"force of the {arm} fingers", TOOL_NAME, arm, "press", (exerted.normals.max(1) - scene.squeeze) / room
            ),
            _Use(f"{arm} hand's payload", TOOL_NAME, arm, "carry", carried),
        ]

    # What gives way.

    def _rejection(self, segment: ToolSegment, loads: Mapping[str, _Load], bearing: _Bearing) -> Rejection:
        time, scene = segment.trajectory.time, self.scene
        use, sample = bearing.nearest
        if use.arm is None:
            weakest = least_margin(in_axes(loads[TOOL_NAME].poses, bearing.suction), scene.tool.cup)
            where = f"{use.body}, {time[weakest.sample]:.3f} s into a {segment.kind.value}"
            return Rejection.measured("suction", weakest.limit.value, where, *weakest.figures)
        where = f"{use.arm} hand, {time[sample]:.3f} s into a {segment.kind.value}"
        k = next(k for k, hold in enumerate(bearers(segment)) if hold.arm == use.arm)
        hold, hand = bearers(segment)[k], bearing.hands[k]
        if use.stage == "carry":
            needed = float(np.linalg.norm(hand.forces[sample].sum(axis=0)))
            return Rejection.measured("carry", OVERLOADED, where, needed, scene.carry_force_limits[use.arm], "N")
        if use.stage == "press":
            return Rejection.measured(
                "grip", PRESSED, where, float(hand.normals[sample].max()), scene.grip_force_limit, "N"
            )
        asked = _exerted(hand.forces[sample], hand.torques[sample], hold.width)
        needed = float(least_squeeze(asked[None], hold.width, scene.friction.grip, scene.friction.eps)[0])
        return Rejection.measured("grip", UNGRIPPED, where, needed, scene.squeeze, "N")

    def _resting(self, segment: ToolSegment, places: Mapping[str, Transform]) -> tuple[RestingPoints, Array | None]:
        """Return what the object on the cup stands on, and with which forces; None if it would tip over."""
        assert segment.sucked is not None
        name = segment.sucked.name
        mass = self._masses[name]
        below = {n: (b.solid.flat_pieces(), places[n]) for n, b in self._bodies.items() if n not in (name, TOOL_NAME)}
        points = resting_points(self._bodies[name].solid.flat_pieces(), places[name], below | self._fixed)
        com = mass.centres(places[name][None])[0]
        return points, points.forces(mass.mass * float(np.linalg.norm(self.scene.cell.gravity)), com)

    # Contact sets.

    def _standing(self, segment: ToolSegment, places: Mapping[str, Transform]) -> tuple[ExertedForce, ...]:
        points, forces = self._resting(segment, places)
        assert forces is not None
        up = np.array([0.0, 0.0, 1.0])
        wrenches = np.outer(forces, [0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        return tuple(
            ExertedForce(by, "environment", point, up, wrench)
            for by, point, wrench in zip(points.by, points.points, wrenches, strict=True)
        )

    def _samples(self, segment: ToolSegment, loads: Mapping[str, _Load]) -> list[int]:
        """Return first and last sample and, between them, as few as the rules of documents and certificates allow."""
        time = segment.trajectory.time
        inner = (
            k for pair in pairwise(self._spaced(time, loads)) for k in (*self._uncounted(time, loads, *pair), pair[1])
        )
        return [0, *inner]

    def _spaced(self, time: Array, loads: Mapping[str, _Load]) -> list[int]:
        """Return samples with no more than a pause between them, nor more of a turn or of a way, there and back."""
        settings = self.settings
        spent = [time[None] / settings.set_pause]
        spent += [
            spent_on_the_way(load.poses, load.centres, settings.set_rotation, settings.set_travel)
            for load in loads.values()
        ]
        return [0, *spaced(np.concatenate(spent)), len(time) - 1]

    def _uncounted(self, time: Array, loads: Mapping[str, _Load], one: int, other: int) -> list[int]:
        """Return the samples between two at which inertia must be counted too: always where it differs most."""
        if other - one < 2:
            return []
        share = ((time[one + 1 : other] - time[one]) / (time[other] - time[one]))[:, None]
        off = np.zeros(other - one - 1)
        for load in loads.values():
            missed = load.inertia[one + 1 : other] - (1.0 - share) * load.inertia[one] - share * load.inertia[other]
            force, moment = (np.linalg.norm(part, axis=1) for part in (missed[:, :3], missed[:, 3:]))
            allowed = self.settings.set_inertia * float(np.linalg.norm(load.weight))
            off = np.maximum(off, np.maximum(force, moment / load.gyration) / allowed)
        worst = int(np.argmax(off))
        if off[worst] <= 1.0:
            return []
        middle = one + 1 + worst
        before, after = (self._uncounted(time, loads, *ends) for ends in ((one, middle), (middle, other)))
        return [*before, middle, *after]

    def _sets_at(
        self,
        segment: ToolSegment,
        loads: Mapping[str, _Load],
        bearing: _Bearing,
        standing: tuple[ExertedForce, ...],
        sample: int,
    ) -> Iterator[ToolContactSet]:
        tool = loads[TOOL_NAME]
        forces = list(self._finger_contacts(segment, tool.poses[sample], bearing, sample))
        if segment.sucked is not None:
            name = segment.sucked.name
            point, outward = tool.poses[sample, :3, 3], tool.poses[sample, :3, 2]
            wrench = bearing.suction[sample]
            forces.append(ExertedForce(name, "suction", point, outward, -wrench))
            on_object = [ExertedForce(TOOL_NAME, "suction", point, -outward, wrench), *standing]
            yield ToolContactSet(sample, name, (*on_object, *_inertia(loads[name], sample)))
        yield ToolContactSet(sample, TOOL_NAME, (*forces, *_inertia(tool, sample)))

    @staticmethod
    def _finger_contacts(
        segment: ToolSegment, T_world_tool: Transform, bearing: _Bearing, sample: int
    ) -> Iterator[ExertedForce]:
        for hold, exerted in zip(bearers(segment), bearing.hands, strict=True):
            T = T_world_tool @ hold.T_tool_tcp
            for finger, inward in ((0, 1.0), (1, -1.0)):
                normal = inward * T[:3, 1]
                wrench = np.concatenate(
                    [T[:3, :3] @ exerted.forces[sample, finger], exerted.torques[sample, finger] * T[:3, 1]]
                )
                point = T[:3, 3] - 0.5 * hold.width * normal
                yield ExertedForce(hold.arm, "soft_finger", point, normal, wrench, finger)


def bearers(segment: ToolSegment) -> tuple[ToolHold, ...]:
    """Return the holds that bear the tool all along: not the one that is being taken or given up."""
    return segment.holds[1:] if segment.kind in (SegmentKind.GRIP, SegmentKind.RELEASE) else segment.holds


def pad_axes(poses: Array, outward: Array) -> Array:
    """Return the x axis of the pad by the document's rule: (n, 3).

    The body's x axis projected on the pad; its y axis where x is square to the pad.

    Args:
        poses: (n, 4, 4) `T_world_body` of the body that the contact is listed on.
        outward: (n, 3) unit, square to the pad.
    """
    x, y = (poses[:, :3, k] - outward * np.sum(poses[:, :3, k] * outward, axis=1, keepdims=True) for k in (0, 1))
    axes = np.where(np.linalg.norm(x, axis=1, keepdims=True) > PAD_AXIS_LENGTH, x, y)
    return axes / np.linalg.norm(axes, axis=1, keepdims=True)


def _about_tcp(hold: ToolHold, needed: Array, tool_poses: Array) -> Array:
    """Write wrenches (n, 6) about the lip, world axes, about a hand's TCP and in its axes."""
    tcp = tool_poses @ hold.T_tool_tcp
    return in_axes(tcp, wrench_about(needed, tool_poses[:, :3, 3], tcp[:, :3, 3]))


def _exerted(forces: Array, torques: Array, width: float) -> Array:
    """Return the wrench (6,) about the TCP that two fingers exert together, with forces (2, 3) and torques (2,)."""
    levers = np.array([[0.0, -0.5 * width, 0.0], [0.0, 0.5 * width, 0.0]])
    moment = np.cross(levers, forces).sum(axis=0)
    moment[1] += torques.sum()
    return np.concatenate([forces.sum(axis=0), moment])


def _inertia(load: _Load, sample: int) -> tuple[ExertedForce, ...]:
    """Return the entry of kind `inertia`; none where there is no motion."""
    wrench = load.inertia[sample]
    if not wrench.any():
        return ()
    return (ExertedForce("", "inertia", load.centres[sample], np.zeros(3), wrench),)


def _mass_properties(body: Body) -> MassProperties:
    assert body.mass is not None
    return MassProperties.homogeneous(body.mass, body.com, *body.solid.surface())
