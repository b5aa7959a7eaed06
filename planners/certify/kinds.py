"""Segments do what their kind says."""

from __future__ import annotations

import numpy as np

from planners.certify.certificate import Check, Finding
from planners.certify.motion import SegmentMotion
from planners.certify.settings import CertifySettings

_RESTING = ("transit", "approach", "retreat", "grip", "release")
"""Kinds in which no body moves; a transfer may move the plate, and need not."""
_FINGERS = {"grip": -1.0, "release": 1.0}
"""Sign of the change of an opening."""
_LIFT_KINDS = (*_RESTING, "transfer")
"""The others pass bodies from hand to hand or switch vacuum: in a plate lift the cup holds from first to last."""


def kind_check(motions: list[SegmentMotion], settings: CertifySettings) -> Check:
    """Check what moves in segments of each kind: the plate in transfers only, fingers alone in grips and releases."""
    finding = Finding("kinds", "1")
    for motion in motions:
        segment, where = motion.segment, motion.segment.place()
        finding.require(segment.kind in _LIFT_KINDS, where, "has no place in a plate lift")
        if segment.kind in _RESTING:
            for name, poses in segment.body_poses.items():
                still = float(np.ptp(poses, axis=0).max()) <= settings.join
                finding.require(still, where, f"{name} moves")
        if segment.kind in _FINGERS:
            change = _FINGERS[segment.kind] * np.array([w[-1] - w[0] for w in segment.widths.values()])
            finding.require(change.max(initial=0.0) > settings.join, where, "no fingers move as the kind says")
            finding.require(change.min(initial=0.0) >= -settings.join, where, "fingers move the other way")
            still = float(np.ptp(segment.positions, axis=0).max()) <= settings.join
            finding.require(still, where, "joints move with the fingers")
    return finding.check()
