"""Stations along a rim: how many, and where."""

from __future__ import annotations

import numpy as np
import pytest

from planners.geometry.polygon import depth_inside, rectangle
from planners.manipulation.holds.rim import REFERENCE_RIM, RimPatch, rim_stations, station_count

REACH = 0.5
"""Of the arm [m]."""
PATCH = RimPatch(half_width=0.011, depth_from=0.002, depth_to=0.035)
ROUND = 0.15 * np.column_stack([np.cos(2 * np.pi / 64 * np.arange(64)), np.sin(2 * np.pi / 64 * np.arange(64))])
SQUARE = rectangle(0.3, 0.3)
KITE = np.array([[0.3, 0.0], [0.0, 0.2], [-0.1, 0.0], [0.0, -0.2]])


@pytest.mark.parametrize("reference", [8, 16, 30])
def test_four_times_the_rim_gets_twice_the_stations(reference):
    assert station_count(reference, REFERENCE_RIM * REACH, REACH) == reference
    assert station_count(reference, 4 * REFERENCE_RIM * REACH, REACH) == 2 * reference


@pytest.mark.parametrize("rim", np.linspace(0.3, 4.0, 30))
def test_the_count_is_even_and_grows_with_the_rim(rim):
    assert station_count(30, rim, REACH) % 2 == 0
    assert station_count(30, rim, REACH) <= station_count(30, rim + 0.1, REACH)


@pytest.mark.parametrize("scale", [0.5, 2.0, 2.6])
@pytest.mark.parametrize("outline", [SQUARE, KITE])
def test_a_plate_and_an_arm_of_another_scale_have_the_same_stations_to_scale(outline, scale):
    patch = RimPatch(*(scale * length for length in (PATCH.half_width, PATCH.depth_from, PATCH.depth_to)))
    points = np.array([station.point for station in rim_stations(outline, 30, PATCH, REACH)])
    scaled = np.array([station.point for station in rim_stations(scale * outline, 30, patch, scale * REACH)])
    assert scaled == pytest.approx(scale * points)


@pytest.mark.parametrize("outline", [ROUND, KITE])
def test_the_stations_of_an_outline_that_is_symmetric_about_x_are_too(outline):
    points = np.array([station.point for station in rim_stations(outline, 30, PATCH, REACH)])
    assert len(points) > 10
    assert np.all(np.linalg.norm(points[:, None] * [1, -1] - points[None], axis=2).min(axis=1) < 1e-9)


@pytest.mark.parametrize("outline", [ROUND, KITE])
def test_the_patch_of_every_station_lies_within_the_outline(outline):
    for station in rim_stations(outline, 30, PATCH, REACH):
        assert depth_inside(outline, station.point[None])[0] == pytest.approx(0.0, abs=1e-9)
        corners = [
            station.point + width * station.along + depth * station.inward
            for width in (-PATCH.half_width, PATCH.half_width)
            for depth in (PATCH.depth_from, PATCH.depth_to)
        ]
        assert depth_inside(outline, np.array(corners)).min() > -1e-9


def test_a_round_outline_has_stations_all_around():
    stations = rim_stations(ROUND, 30, PATCH, REACH)
    azimuths = np.sort([np.arctan2(station.point[1], station.point[0]) for station in stations])
    gaps = np.diff([*azimuths, azimuths[0] + 2 * np.pi])
    assert gaps == pytest.approx(np.full(len(stations), 2 * np.pi / len(stations)), rel=0.05)


def test_an_outline_too_small_for_the_patch_has_none():
    assert rim_stations(0.05 * ROUND, 30, PATCH, REACH) == ()
