"""Segments do what their kind says."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.certify.finding import Finding
from planners.certify.motion import SegmentMotion
from planners.certify.settings import CertifySettings
from planners.plan.verdicts import Check

_FINGERS = {"grip": -1.0, "release": 1.0}
"""Sign of the change of an opening."""


@dataclass(frozen=True)
class KindRules:
    """What segments of each kind may do in one kind of plan."""

    plan: str
    """What the plan is called."""
    kinds: frozenset[str]
    """Those that it may have."""
    bodies_rest: frozenset[str]
    """Kinds in which no body moves."""
    joints_rest: frozenset[str]
    """Kinds in which no joint moves."""


_HANDS_ONLY = frozenset({"transit", "approach", "retreat", "grip", "release"})
PLATE_LIFT = KindRules("plate lift", _HANDS_ONLY | {"transfer"}, _HANDS_ONLY, frozenset(_FINGERS))
"""A transfer may move the plate, and need not; the cup holds from first to last."""
_STANDING = frozenset({*_FINGERS, "handover", "attach", "detach"})
SUCTION_TOOL = KindRules(
    "suction-tool plan", _HANDS_ONLY | _STANDING | {"transfer"}, _HANDS_ONLY | _STANDING, _STANDING
)


def kind_check(motions: list[SegmentMotion], rules: KindRules, settings: CertifySettings) -> Check:
    """Check what moves in segments of each kind: bodies in transfers only, fingers alone in grips and releases."""
    finding = Finding("kinds", "1")
    for motion in motions:
        segment, where = motion.segment, motion.segment.place()
        finding.require(segment.kind in rules.kinds, where, f"has no place in a {rules.plan}")
        if segment.kind in rules.bodies_rest:
            for name, poses in segment.body_poses.items():
                still = float(np.ptp(poses, axis=0).max()) <= settings.join
                finding.require(still, where, f"{name} moves")
        if segment.kind in _FINGERS:
            change = _FINGERS[segment.kind] * np.array([w[-1] - w[0] for w in segment.widths.values()])
            finding.require(change.max(initial=0.0) > settings.join, where, "no fingers move as the kind says")
            finding.require(change.min(initial=0.0) >= -settings.join, where, "fingers move the other way")
        if segment.kind in rules.joints_rest:
            still = float(np.ptp(segment.positions, axis=0).max()) <= settings.join
            finding.require(still, where, "joints move with the fingers" if segment.kind in _FINGERS else "joints move")
    return finding.check()
