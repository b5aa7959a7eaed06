"""Whether bodies that rest on one another stand, by the laws of statics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest
from scipy.optimize import linprog

from planners.contract.shapes import Box
from planners.geometry.pose import Array, Transform, rotation_z, transform
from planners.scene.body import Body
from planners.scene.rest import Footing, LevelFace, Unsupported, find_footing, level_places
from planners.scene.solid import solid_of
from planners.scene.standing import Fall, Standing, first_fall

TABLE = LevelFace("table", 0.0, np.array([[-5.0, -5.0], [5.0, -5.0], [5.0, 5.0], [-5.0, 5.0]]))
HEIGHT = 0.02
Given = tuple[Sequence[float], float, Sequence[float]]
"""Length and width [m], mass [kg], and x, y [m] and level of a box."""


@dataclass(frozen=True, eq=False)
class Pile:
    """Boxes of one height whose sides are along x and y."""

    bodies: tuple[Body, ...]
    footings: tuple[Footing, ...]

    def fall(self) -> Fall | None:
        return first_fall(self.bodies, self.footings)

    def side(self, i: int) -> Array:
        """The box's lower and upper corner seen from above."""
        half = np.array(self.bodies[i].shape.size[:2]) / 2  # pyright: ignore[reportAttributeAccessIssue]
        return np.array([-half, half]) + self.bodies[i].T_world_body[:2, 3]

    def level(self, i: int) -> int:
        return round((self.bodies[i].T_world_body[2, 3] - HEIGHT / 2) / HEIGHT)


def box(name: str, size: Sequence[float], mass: float, T: Transform) -> Body:
    shape = Box(type="box", size=(size[0], size[1], HEIGHT))
    return Body(name, "object", shape, solid_of(shape), mass, np.zeros(3), T, static=False)


def pile(boxes: Sequence[Given]) -> Pile:
    """Put boxes where each stands alone."""
    found = Pile((), ())
    for given in boxes:
        higher = with_one_more(found, *given)
        assert higher is not None
        found = higher
    return found


def with_one_more(found: Pile, size: Sequence[float], mass: float, place: Sequence[float]) -> Pile | None:
    """Add a box of (length, width) at (x, y, level); None where it does not stand alone."""
    x, y, level = place
    body = box(f"box{len(found.bodies)}", size, mass, transform(None, [x, y, (level + 0.5) * HEIGHT]))
    places = [place for each in found.bodies for place in level_places(each.name, each.solid, each.T_world_body)]
    footing = find_footing(body.solid, body.T_world_body, body.com, [TABLE, *places])
    if isinstance(footing, Unsupported):
        return None
    return Pile((*found.bodies, body), (*found.footings, footing))


def random_pile(seed: int, *, tower: bool) -> Pile:
    """Add boxes, in a tower each on the one before, that stand alone and overlap no other."""
    rng = np.random.default_rng(seed)
    found, spread = pile([([0.2, 0.2], 1.0, [0.0, 0.0, 0])]), 0.35 if tower else 0.4
    while len(found.bodies) < (6 if tower else 8):
        size, mass = rng.uniform([0.04, 0.04], [0.3, 0.2]), float(10.0 ** rng.uniform(-1.5, 1.0))
        under = len(found.bodies) - 1 if tower else int(rng.integers(len(found.bodies)))
        low, high = found.side(under)
        center = (low + high) / 2 + rng.uniform(-spread, spread, 2) * (high - low)
        level = found.level(under) + 1
        room = [abs(found.level(i) - level) > 0 or apart(found.side(i), center, size) for i in range(len(found.bodies))]
        # What is above would rest on it: piles grow upwards only.
        room += [found.level(i) != level + 1 or apart(found.side(i), center, size) for i in range(len(found.bodies))]
        higher = with_one_more(found, size.tolist(), mass, [*center, level]) if all(room) else None
        found = found if higher is None else higher
    return found


def apart(side: Array, center: Array, size: Array) -> bool:
    return bool(np.any((side[0] > center + size / 2) | (side[1] < center - size / 2)))


@pytest.mark.parametrize(("out", "stands"), [(0.0199, True), (0.0201, False)])
def test_two_boxes_fall_where_their_common_centre_is_beyond_the_edge(out: float, stands: bool) -> None:
    # The lower one sticks out of a board of 0.2 m and its centre is 20 mm inside; the centre of both is `out` farther.
    board = ([0.2, 0.2], 9.0, [0.0, 0.0, 0])
    lower = ([0.2, 0.1], 1.0, [0.08, 0.0, 1])
    upper = ([0.05, 0.05], 1.0, [0.08 + 2.0 * out, 0.0, 2])
    fall = pile([board, lower, upper]).fall()
    if stands:
        assert fall is None
    else:
        assert fall is not None
        assert fall.names == ("box1", "box2")
        assert "their common centre of mass is 0.1 mm beyond what carries them" in str(fall)


def test_the_weight_of_what_lies_on_a_box_holds_it_as_well_as_it_tips_it() -> None:
    board, beam = ([0.1, 0.1], 1.0, [0.0, 0.0, 0]), ([0.3, 0.05], 0.1, [0.0, 0.0, 1])
    left, right = ([0.04, 0.04], 1.0, [-0.12, 0.0, 2]), ([0.04, 0.04], 1.0, [0.12, 0.0, 2])
    assert pile([board, beam, left, right]).fall() is None
    assert pile([board, beam, left]).fall() is not None
    assert pile([board, beam, right]).fall() is not None


@pytest.mark.parametrize("seed", range(25))
def test_a_tower_stands_where_all_above_each_joint_have_their_centre_above_it(seed: int) -> None:
    tower = random_pile(seed, tower=True)
    masses = np.array([body.mass for body in tower.bodies])
    centers = np.array([body.T_world_body[:2, 3] for body in tower.bodies])
    depths = []
    for i in range(1, len(tower.bodies)):
        below, above = tower.side(i - 1), tower.side(i)
        low, high = np.maximum(below[0], above[0]), np.minimum(below[1], above[1])
        center = np.average(centers[i:], axis=0, weights=masses[i:])
        depths.append(min((center - low).min(), (high - center).min()))
    assert (tower.fall() is None) == (min(depths) >= 0.0)


@pytest.mark.parametrize("seed", range(25))
def test_a_pile_stands_where_a_linear_program_finds_forces(seed: int) -> None:
    found = random_pile(seed, tower=False)
    columns, count = [], len(found.bodies)
    for i, j in product(range(count), range(-1, count)):
        if found.level(i) != (found.level(j) + 1 if j >= 0 else 0):
            continue
        sides = found.side(i) if j < 0 else np.array([found.side(i), found.side(j)])
        low, high = (sides[0], sides[1]) if j < 0 else (sides[:, 0].max(axis=0), sides[:, 1].min(axis=0))
        if np.any(high - low <= 1e-9):
            continue
        for x, y in product((low[0], high[0]), (low[1], high[1])):
            column = np.zeros((count, 3))
            column[i] = 1.0, x, y
            if j >= 0:
                column[j] = -1.0, -x, -y
            columns.append(column.ravel())
    weights = [body.mass * np.append(1.0, body.T_world_body[:2, 3]) for body in found.bodies]  # pyright: ignore[reportOptionalOperand]
    matrix = np.column_stack(columns)
    answer = linprog(np.zeros(matrix.shape[1]), A_eq=matrix, b_eq=np.ravel(weights))
    assert (found.fall() is None) == answer.success


def test_random_piles_are_of_both_kinds() -> None:
    for tower in (True, False):
        falls = [random_pile(seed, tower=tower).fall() is not None for seed in range(25)]
        assert 5 < sum(falls) < 20


@pytest.mark.parametrize("seed", range(10))
def test_neither_units_nor_the_direction_nor_the_order_change_what_falls(seed: int) -> None:
    found = random_pile(seed, tower=False)
    fallen = found.fall()
    T = transform(rotation_z(0.7), [0.3, -0.2, 0.0])
    heavier = [
        replace(body, mass=100.0 * (body.mass or 0.0), T_world_body=T @ body.T_world_body) for body in found.bodies
    ]
    there = {body.name: (body, body.T_world_body) for body in reversed(heavier)}
    again = Standing([TABLE]).fall(there)
    assert set(() if again is None else again.names) == set(() if fallen is None else fallen.names)


def test_what_is_asked_before_changes_no_answer() -> None:
    found = pile(
        [([0.2, 0.2], 9.0, [0.0, 0.0, 0]), ([0.2, 0.1], 1.0, [0.08, 0.0, 1]), ([0.05, 0.05], 1.0, [0.14, 0.0, 2])]
    )
    standing, there = Standing([TABLE]), {body.name: (body, body.T_world_body) for body in found.bodies}
    last = found.bodies[-1]
    back = there | {last.name: (last, transform(None, [-0.08, 0.0, 0.0]) @ last.T_world_body)}
    for _ in range(2):
        fall = standing.fall(there)
        assert fall is not None
        assert fall.names == ("box1", "box2")
        assert standing.fall(back) is None


def test_what_rests_on_nothing_any_more_falls() -> None:
    found = pile([([0.1, 0.1], 1.0, [0.0, 0.0, 0]), ([0.1, 0.1], 1.0, [0.0, 0.0, 1])])
    low, high = found.bodies
    assert not isinstance(found.footings[1], Unsupported)
    fall = Standing([TABLE]).fall({high.name: (high, high.T_world_body)})
    assert fall is not None
    assert str(fall).startswith("box1 rests on nothing")
    assert Standing([TABLE]).fall({low.name: (low, low.T_world_body)}) is None
