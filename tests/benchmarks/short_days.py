"""`liftwright`, whose workers delete old plans every few seconds in place of once an hour; all else is as it is.

The engine and the databases have clocks of their own, so no clock is simulated: `LIFTWRIGHT_RETENTION_DAYS` is set to a
minute or so, and this makes the pause between two rounds of deletion as much shorter.
"""

from __future__ import annotations

import os
import sys

PAUSE = "LIFTWRIGHT_DELETION_PAUSE_SECONDS"
"""Environment variable with the pause [s]."""

if __name__ == "__main__":
    import workers.engine.housekeeping

    # Before the module of the worker is read, which takes it from there.
    workers.engine.housekeeping.DELETION_PAUSE_SECONDS = float(os.environ[PAUSE])
    from app.cli.main import main

    sys.exit(main(sys.argv[1:]))
