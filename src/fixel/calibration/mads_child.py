"""Runs NOMAD in a process of its own; see mads.py. Imports nothing of fixel.

Lines of JSON: reads the problem, then again and again writes points and reads their errors (null
for one that failed), at last writes why NOMAD ended. Ends when nobody is left at the other side.
"""

import json
import os
import sys
from typing import Any

# Put for a start that failed: NOMAD would not search on without a value there.
AWFUL = 1e20


def main() -> None:
    """Serve one search."""
    # NOMAD writes to the standard output whatever it is told: keep that for the answers alone.
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    problem = json.loads(sys.stdin.readline())
    import PyNomad

    waits_for_start = True

    def evaluate(block: Any) -> list[int]:
        nonlocal waits_for_start
        places = [block.get_x(k) for k in range(block.size())]
        points = [[place.get_coord(i) for i in range(place.size())] for place in places]
        print(json.dumps({"points": points}), file=answers, flush=True)
        line = sys.stdin.readline()
        if not line:
            os._exit(0)
        errors = json.loads(line)
        if waits_for_start:
            errors[0] = AWFUL if errors[0] is None else errors[0]
            waits_for_start = False
        for place, error in zip(places, errors, strict=True):
            place.setBBO(b"inf" if error is None else repr(error).encode())
        return [int(error is not None) for error in errors]

    low, high, options = problem["low"], problem["high"], problem["options"]
    result = PyNomad.optimize(evaluate, problem["start"], low, high, options)
    print(json.dumps({"ended": result["stop_reason"]}), file=answers, flush=True)


if __name__ == "__main__":
    main()
