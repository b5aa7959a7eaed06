"""A solver process that answers with documents that are there already: files in a folder, by `external_id`."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from workers.solver.process import COMPILE, main
from workers.solver.protocol import Answer, SolverRequest


def solve(request: SolverRequest, *_: object) -> Answer:
    document = json.loads((Path(sys.argv[1]) / f"{request['task']['external_id']}.json").read_text())
    return Answer(document["outcome"], json.dumps({**document, "id": request["id"]}).encode())


if __name__ == "__main__":
    if COMPILE not in sys.argv:
        main(lambda: solve)
