"""Servers to be killed: `python -m tests.web.mortal FOLDER` starts one for each line it reads.

Each is a fork of this process, which has everything loaded; it writes its number, port and token.
"""

import json
import os
import sys
from pathlib import Path


def main():
    folder = Path(sys.argv[1])
    from fixel.database.project import Project
    from fixel.web.context import ProjectContext
    from fixel.web.project import project_server
    from fixel.web.views import live_comparison

    live_comparison.warm_up()
    for _ in sys.stdin:
        child = os.fork()
        if child == 0:
            server = project_server(ProjectContext(Project(folder))).start()
            said = {"pid": os.getpid(), "port": server.port, "token": server.gate.token}
            print(json.dumps(said), flush=True)
            server.wait()
            os._exit(0)
        os.waitpid(child, 0)
        print("dead", flush=True)


if __name__ == "__main__":
    main()
