"""A process that is asked whether lifts have ways, and answers with its process id and how often it was asked.

What it does is told by the lift's `external_id`: `slow` takes a while, `die` kills itself, `unknown` knows nothing.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable

from workers.solver.process import Channel, answer_each
from workers.solver.protocol import FeasibilityRequest, Message

SLOW_SECONDS = 0.5


def prepare() -> Callable[[bytes, Channel], None]:
    asked = 0

    def answer(line: bytes, channel: Channel) -> None:
        nonlocal asked
        asked += 1
        wish = FeasibilityRequest.read(line).lift["external_id"]
        if wish == "slow":
            time.sleep(SLOW_SECONDS)
        if wish == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        channel.send(Message(feasibility=() if wish == "unknown" else (float(asked), str(os.getpid()))))

    return answer


if __name__ == "__main__":
    answer_each(prepare)
