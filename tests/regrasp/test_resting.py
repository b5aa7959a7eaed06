"""What a body stands on, and how it stands, by the laws of statics."""

from __future__ import annotations

import numpy as np
import pytest

from planners.contract.shapes import Box
from planners.geometry.pose import rotation_x, rotation_z, transform
from planners.regrasp.statics.resting import RestingPoints, resting_points
from planners.scene.solid import FlatFace, solid_of

WEIGHT = 3.0


def faces(size: tuple[float, float, float]) -> list[FlatFace]:
    return solid_of(Box(type="box", size=size)).flat_pieces()


TABLE = faces((1.0, 1.0, 0.1)), transform(None, [0.0, 0.0, -0.05])


def on_the_table(size: tuple[float, float, float], x: float = 0.0, lift: float = 0.0) -> RestingPoints:
    return resting_points(faces(size), transform(None, [x, 0.0, size[2] / 2 + lift]), {"table": TABLE})


def test_a_box_on_a_table_stands_on_its_four_corners() -> None:
    found = on_the_table((0.2, 0.1, 0.04))
    assert found.by == ("table",) * 4
    corners = {(x, y, 0.0) for x in (-0.1, 0.1) for y in (-0.05, 0.05)}
    assert {tuple(np.round(point, 9) + 0.0) for point in found.points} == corners


def test_a_box_over_the_edge_stands_on_the_part_that_is_on_the_table() -> None:
    found = on_the_table((0.2, 0.1, 0.04), x=0.45)
    assert found.points[:, 0].max() == pytest.approx(0.5)
    assert found.points[:, 0].min() == pytest.approx(0.35)


@pytest.mark.parametrize(("lift", "count"), [(0.0009, 4), (-0.0009, 4), (0.0012, 0), (-0.0012, 0)])
def test_a_body_rests_within_a_millimetre(lift: float, count: int) -> None:
    assert len(on_the_table((0.2, 0.1, 0.04), lift=lift).points) == count


@pytest.mark.parametrize(("degrees", "count"), [(0.09, 4), (0.2, 0)])
def test_a_tilted_face_does_not_rest(degrees: float, count: int) -> None:
    pose = transform(rotation_x(np.radians(degrees)), [0.0, 0.0, 0.02])
    assert len(resting_points(faces((0.2, 0.1, 0.04)), pose, {"table": TABLE}).points) == count


def test_a_body_between_two_others_stands_on_both() -> None:
    pads = {name: (faces((0.05, 0.1, 0.02)), transform(None, [x, 0.0, 0.01])) for name, x in (("a", -0.1), ("b", 0.1))}
    found = resting_points(faces((0.25, 0.08, 0.04)), transform(None, [0.0, 0.0, 0.04]), pads)
    assert {(by, float(np.sign(point[0]))) for by, point in zip(found.by, found.points, strict=True)} == {
        ("a", -1.0),
        ("b", 1.0),
    }


def test_what_is_lower_than_what_a_body_stands_on_bears_nothing() -> None:
    """A box that sticks out over the edge of a sheet does not touch the table there."""
    sheet = faces((0.1, 0.1, 0.0008)), transform(None, [-0.02, 0.0, 0.0004])
    pose = transform(None, [0.0, 0.0, 0.0208])
    found = resting_points(faces((0.2, 0.1, 0.04)), pose, {"table": TABLE, "sheet": sheet})
    assert set(found.by) == {"sheet"}
    assert found.points[:, 0].max() == pytest.approx(0.03)


@pytest.mark.parametrize("seed", range(20))
def test_forces_carry_the_weight_without_a_moment_and_never_pull(seed: int) -> None:
    rng = np.random.default_rng(seed)
    found = resting_points(
        faces((0.2, 0.1, 0.04)), transform(rotation_z(rng.uniform(-3, 3)), [0.1, 0.2, 0.02]), {"table": TABLE}
    )
    shares = rng.dirichlet(np.ones(len(found.points)) * 0.4)
    com = shares @ found.points + [0.0, 0.0, 0.03]
    forces = found.forces(WEIGHT, com)
    assert forces is not None
    assert forces.min() >= 0.0
    assert forces.sum() == pytest.approx(WEIGHT)
    assert forces @ found.points[:, :2] == pytest.approx(WEIGHT * com[:2])


def test_a_body_whose_centre_is_beyond_what_it_stands_on_tips_over() -> None:
    found = on_the_table((0.2, 0.1, 0.04), x=0.45)
    assert found.forces(WEIGHT, np.array([0.499, 0.0, 0.02])) is not None
    assert found.forces(WEIGHT, np.array([0.502, 0.0, 0.02])) is None


def test_a_body_on_nothing_has_no_forces() -> None:
    assert on_the_table((0.2, 0.1, 0.04), lift=0.1).forces(WEIGHT, np.zeros(3)) is None
