"""Random plate lifts, see `tests.support.random_holds`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from planners.balance.contacts import GripContacts, PushContact
from planners.geometry.pose import Array
from tests.support.random_holds import Lift, random_grip, random_lift, random_push


@pytest.fixture(scope="session", name="random_lift")
def random_lifts() -> Callable[..., Lift]:
    """A lift by seed, lifter model, number of environment points and hands."""
    return random_lift


@pytest.fixture(scope="session")
def random_hands() -> Callable[[np.random.Generator, Array], tuple[GripContacts, PushContact]]:
    """A grip on the rim and a push, on a plate with these half lengths."""
    return lambda rng, half: (random_grip(rng, half), random_push(rng, half))
