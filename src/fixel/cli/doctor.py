"""`fixel doctor`: check an installation."""

from typing import TYPE_CHECKING

import typer

from fixel.cli.options import AsJson
from fixel.cli.screen import print_answer, seconds

if TYPE_CHECKING:
    from fixel.workflows.diagnostics import Diagnosis


def doctor(as_json: AsJson = False) -> None:
    """Check this installation and report how to repair it."""
    from fixel.workflows.diagnostics import examine

    found = examine()
    print_answer(as_json, found.summary, lambda: _lines(found))
    if not found.passed:
        raise typer.Exit(1)


def _lines(found: "Diagnosis") -> list[str]:
    from fixel.workflows.diagnostics import worst_residual

    versions = [f"{name} {number}" for name, number in found.versions.items()]
    state = "warm" if found.cache["warm"] else "compiled just now"
    failed = sum(not check.passed for check in found.checks)
    verdict = f"{failed} of {len(found.checks)} checks failed" if failed else "All checks passed"
    return [
        ", ".join(versions[:4]),
        ", ".join(versions[4:]),
        f"{found.machine['platform']}, {found.machine['cores']} cores,"
        f" batches on {found.machine['threads']} threads",
        f"kernels  {found.cache['folder']}",
        f"         {found.cache['bytes'] / 1e6:.1f} MB, {state}",
        "",
        *(_line(c.name, c.passed, c.detail, c.residual) for c in found.checks),
        "",
        f"{verdict}. Worst residual {worst_residual(found.checks):.1e}; took"
        f" {seconds(found.seconds)}.",
        "Next: fixel demo" if not failed else "Please report the lines marked FAIL.",
    ]


def _line(name: str, passed: bool, detail: str, residual: float | None) -> str:
    mark = "PASS" if passed else "FAIL"
    end = "" if residual is None else f"  (residual {residual:.0e})"
    return f"{mark}  {name:42}  {detail}{end}"
