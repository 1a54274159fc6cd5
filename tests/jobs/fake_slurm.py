"""A SLURM of paper: `sbatch`, `squeue` and `scancel` that do what a test has written down.

The three commands are this file under other names. They share one JSON file:

    jobs    number -> {state, reason, name, script}
    plan    what the next calls of sbatch do: "ok", "fail WORDS", "lie WORDS" (accepted, but says it
            failed), "say WORDS"; "ok" when nothing is planned
    down    whether squeue does not answer
    stuck   whether scancel does not answer
    state   of new jobs
    calls   of sbatch, as times
"""

import json
import os
import stat
import sys
import time
from pathlib import Path

VARIABLE = "FAKE_SLURM"
EMPTY = {"jobs": {}, "plan": [], "down": False, "stuck": False, "state": "RUNNING", "calls": []}


class FakeSlurm:
    """The commands in a folder, and the hand of the test on them."""

    def __init__(self, folder):
        self.folder = folder
        self._file = folder / "slurm.json"
        self._file.write_text(json.dumps(EMPTY))
        for name in ("sbatch", "squeue", "scancel"):
            command = folder / name
            command.write_text(f"#!{sys.executable} -SE\n" + Path(__file__).read_text())
            command.chmod(command.stat().st_mode | stat.S_IXUSR)

    def __getitem__(self, key):
        return json.loads(self._file.read_text())[key]

    def set(self, **changes):
        """Change what the commands find."""
        self._file.write_text(json.dumps(json.loads(self._file.read_text()) | changes))

    def job(self, number, **changes):
        """Change a job."""
        jobs = self["jobs"]
        jobs[str(number)] = jobs.get(str(number), {}) | changes
        self.set(jobs=jobs)

    def active(self):
        """Numbers of jobs that wait or run."""
        return sorted(int(k) for k, j in self["jobs"].items() if j["state"] in _ACTIVE)


_ACTIVE = ("PENDING", "RUNNING", "REQUEUED")


def sbatch(content, arguments):
    content["calls"].append(time.time())
    step = content["plan"].pop(0) if content["plan"] else "ok"
    kind, _, words = step.partition(" ")
    if kind == "fail":
        return words, 1
    script = Path(arguments[-1]).read_text()
    (name,) = [w.split()[-1] for w in script.splitlines() if w.startswith("#SBATCH -J")]
    number = str(max([100, *map(int, content["jobs"])]) + 1)
    content["jobs"][number] = {
        "state": content["state"],
        "reason": "Priority" if content["state"] == "PENDING" else "None",
        "name": name,
        "script": script,
    }
    return {"lie": (words, 1), "say": (words, 0)}.get(kind, (number, 0))


def squeue(content, arguments):
    if content["down"]:
        return "slurm_load_jobs error: Unable to contact slurm controller", 1
    (name,) = [a.partition("=")[2] for a in arguments if a.startswith("--name=")]
    jobs = {k: j for k, j in content["jobs"].items() if j["name"] == name}
    return "\n".join(f"{k}|{j['state']}|{j['reason']}" for k, j in jobs.items()), 0


def scancel(content, arguments):
    if content["stuck"]:
        return "scancel: error: Unable to contact slurm controller", 1
    (name,) = [a.partition("=")[2] for a in arguments if a.startswith("--name=")]
    for job in content["jobs"].values():
        if job["name"] == name and job["state"] in _ACTIVE:
            job["state"] = "CANCELLED"
    return "", 0


def main():
    file = Path(os.environ[VARIABLE]) / "slurm.json"
    content = json.loads(file.read_text())
    command = {"sbatch": sbatch, "squeue": squeue, "scancel": scancel}[Path(sys.argv[0]).name]
    words, code = command(content, sys.argv[1:])
    file.write_text(json.dumps(content))
    print(words, file=sys.stderr if code else sys.stdout)
    return code


if __name__ == "__main__":
    sys.exit(main())
