"""``python -m fixel``: the command, where the shell does not find `fixel`."""

from fixel.cli import run

if __name__ == "__main__":
    run()
