"""NOMAD in a process of its own; see external_searches.py. Imports nothing of fixel.

The protocol is lines of JSON: read the problem, then repeatedly write points and read their errors
(null for a failure), and finally write why NOMAD ended. Ends if the standard input is closed.
"""

import json
import os
import sys
from typing import Any

# Error of a start that failed: NOMAD does not continue without a value there.
AWFUL = 1e20


def main() -> None:
    """Run one search."""
    # NOMAD always writes to the standard output: redirect it, and use a copy for the answers.
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
