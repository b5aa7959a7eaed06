"""For which processor kernels are compiled: the one that there is, unless whoever builds an image names another."""

from __future__ import annotations

import os

NAME_VARIABLE = "NUMBA_CPU_NAME"
"""Tells the compiler a model of processors."""
FEATURES_VARIABLE = "NUMBA_CPU_FEATURES"
"""Tells it what they can do besides; without it, what the processor at hand can, whatever the model."""


def unset_empty_names() -> None:
    """Take empty variables from the environment, before the compiler is loaded and for all that is started.

    An image has no way to leave a variable out, and the compiler takes an empty name for a processor without a name,
    for which it compiles what runs everywhere, and slower.
    """
    for variable in (NAME_VARIABLE, FEATURES_VARIABLE):
        if os.environ.get(variable) == "":
            del os.environ[variable]
