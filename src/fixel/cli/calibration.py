"""`fixel calibrations`: list stored calibrations, or show one."""

from pathlib import Path

from fixel.cli.options import AsJson, ProjectFolder, argument, with_options
from fixel.cli.screen import command_of, print_answer
from fixel.errors import NotStored


@with_options
def calibrations(
    *,
    number: int | None = argument(
        None, "Id of a calibration to show; all are listed without it.", metavar="ID"
    ),
    folder: ProjectFolder = Path(),
    as_json: AsJson = False,
) -> None:
    """List stored calibrations, or show the estimates of one."""
    from fixel.database.project import Project
    from fixel.workflows.calibration.stored import list_calibrations, stored_calibration

    project = Project(folder)
    if number is None:
        listed = list_calibrations(project)
        if not listed.rows:
            raise NotStored("calibration", hint="make one with: fixel calibrate")
        last = listed.rows[0][0]
        print_answer(
            as_json,
            lambda: {"calibrations": listed.records()},
            lambda: [*listed.lines(), f"Next: {command_of('calibrations', last, project=folder)}"],
        )
        return
    fit = stored_calibration(project, number)
    print_answer(
        as_json,
        lambda: {
            "calibration": number,
            "estimates": [own.stored() for own in fit.estimates.values()],
            "parameters": dict(fit),
            "rms_error_mm": 1e3 * fit.rms_error,
            "experiments": list(fit.keys_of_experiments),
            **fit.analysis.texts(),
            **{own: getattr(fit, own) for own in ("status", "evaluations", "command", "call")},
        },
        lambda: [repr(fit), *([f"Repeat it: {fit.command}"] if fit.command else [])],
    )
