"""`fixel new`, `import`, `list`, `export` and `data`: a laboratory's project folder."""

import shlex
from collections.abc import Mapping, Sequence
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from fixel.capability.capability import named
from fixel.cli.options import (
    AsJson,
    ProjectFolder,
    argument,
    option,
    project_at,
    required,
    with_options,
)
from fixel.cli.screen import command_line, command_of, notify, print_answer, project_words, wrote
from fixel.errors import InvalidInput, counted, plain
from fixel.progress import show_progress, time_text
from fixel.table import Column, Table, shortened

if TYPE_CHECKING:
    from fixel.database.browsing import ExperimentPage
    from fixel.database.project import AddSummary
    from fixel.datasets import ImportPlan
    from fixel.model.selection import ExperimentRow
    from fixel.workflows.model_export.run import ModelExport
    from fixel.workflows.project.export import ExportAnswer

MAX_ROWS = 30
SEE_EXPORT = "fixel export --help"


@with_options
def new(
    *,
    folder: Path = required("Folder of the new project.", metavar="FOLDER"),
    database: str | None = option(
        None,
        "Database of a server, instead of a file: postgresql+psycopg://USER@HOST/NAME.",
        metavar="URL",
    ),
    as_json: AsJson = False,
) -> None:
    """Create a project folder with settings, database and media."""
    from fixel.database.project import Project

    name = Project.create(folder, database=database).settings.name
    print_answer(
        as_json,
        lambda: {"folder": str(folder), "name": name},
        lambda: [
            f"created project {name} in {folder}",
            "Import recorded experiments with fixel import SOURCE, or try simulated ones:",
            f"Next: {command_of('testbed', 'run', '--limit', 30, '--project', folder)}",
        ],
    )


@with_options
def import_(
    *,
    source: Path = required("File or folder to import.", metavar="SOURCE"),
    folder: ProjectFolder = Path(),
    importer: str | None = option(
        None, "Name of the importer; by default it is recognised.", "--as", metavar="NAME"
    ),
    option: list[str] | None = option(
        None,
        "Option of the importer, such as split_by=push; may be repeated. A wrong name lists all.",
        "--option",
        metavar="NAME=VALUE",
    ),
    scene: Path | None = option(
        None,
        "Scene file for a CSV table, with object, pusher and fixels. Without one, a template is "
        "written next to the table.",
        metavar="FILE",
    ),
    dry_run: bool = option(False, "Print how the source is read; import nothing.", "--dry-run"),
    as_json: AsJson = False,
) -> None:
    """Import recorded experiments, and skip stored ones."""
    from fixel.database.project import Project
    from fixel.workflows.project.importing import write_template

    if source.suffix.lower() == ".zip" and importer is None:
        if unused := "scene" if scene else "option" if option else "":
            raise InvalidInput(f"--{unused}", found="a bundle", expected="a table or a dataset")
        _import_bundle(source, folder, dry_run, as_json)
        return
    if not dry_run:
        project = Project(folder)
    plan = _planned(source, importer, scene, dict(map(_pair, option or ())))
    content: dict[str, Any] = {
        "importer": plan.importer,
        "source": str(source),
        "experiments": plan.n_experiments,
        "understood": list(plan.understood),
    }
    experiments = counted(plan.n_experiments, "experiment")
    lines = [f"{source}: {experiments}, read as {plan.importer}"]
    lines += [f"  {sentence}" for sentence in plan.understood]
    if dry_run:
        content["experiments"] = sum(1 for _ in plan)
        content["skipped"] = list(plan.skipped)
        following = f"Next: {command_line(without='--dry-run')}"
        print_answer(as_json, lambda: content, lambda: [*lines, *_skipped(plan.skipped), following])
        return
    if not as_json:
        typer.echo(plain("\n".join(lines)))
    done = project.add(plan)
    content["skipped"] = list(plan.skipped)
    template = write_template(plan, project.folder)
    if template is not None:
        content |= {
            "template": str(template),
            "next": f"{command_line()} --scene {shlex.quote(str(template))}",
        }
    print_imported(done, content, as_json, folder)


def _planned(
    source: Path, importer: str | None, scene: Path | None, options: dict[str, str]
) -> "ImportPlan":
    """Plan the import of a source; errors name the options of the command."""
    from fixel.datasets import plan_import

    flags = {name: f"--option {name}" for name in ("split_by", "object_name")}
    try:
        return plan_import(source, importer, scene=scene, options=options)
    except InvalidInput as error:
        raise named(error, flags | {"format": "--as", "option": "--option"}) from None


def _skipped(names: Sequence[str]) -> list[str]:
    """List what an import left out, with the reasons."""
    lines = shortened([f"  {name}" for name in names[:MAX_ROWS]], len(names), "  ")
    return [f"skipped {len(names)}:", *lines] if names else []


def _pair(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise InvalidInput("--option", found=repr(text), expected="NAME=VALUE")
    return name, value


def _import_bundle(source: Path, folder: Path, dry_run: bool, as_json: bool) -> None:
    """Import the bundle that another project exported."""
    from fixel.database.project import Project
    from fixel.workflows.project.export import import_zip

    with show_progress(stage="importing") as report:
        counts = import_zip(Project(folder), source, report, dry_run=dry_run)
    n, found = counts.get("known"), ", ".join(_records({**counts, "known": 0})) or "nothing"
    found += f"; {n} {'was' if n == 1 else 'were'} already stored" if n else ""
    verb = "contains" if dry_run else "added"
    following = command_line("--dry-run") if dry_run else command_of("list", project=folder)
    print_answer(
        as_json,
        lambda: {"source": str(source), "dry_run": dry_run, **counts},
        lambda: [f"{source}: {verb} {found}", f"Next: {following}"],
    )


def print_imported(
    done: "AddSummary", content: dict[str, Any], as_json: bool, folder: Path
) -> None:
    """Print how many experiments were stored; `content` is more for the JSON answer."""
    time = time_text(done.wall_time_s)
    time += f", {done.known} were already stored" if done.known else ""
    lines = [
        f"stored {counted(done.new, 'experiment')} in {time}",
        *_skipped(content.get("skipped", ())),
    ]
    if "template" in content:
        lines.insert(
            0,
            "The experiments have no scene, so they cannot be simulated or calibrated. Fill in "
            f"{content['template']}, then import the table again with --scene.",
        )
    if done.faulty:
        lines.append(
            f"{done.faulty} of them have faults in their data; list them with fixel list --all"
        )
    following = content.get("next", command_of("list", project=folder))
    print_answer(as_json, lambda: content | done._asdict(), lambda: [*lines, f"Next: {following}"])


@with_options
def list_(
    *,
    folder: ProjectFolder = Path(),
    dataset: str | None = option(None, "Select only experiments of this dataset.", metavar="NAME"),
    name: str | None = option(
        None, "Select names that match this pattern; * matches any text.", metavar="PATTERN"
    ),
    real: bool | None = option(
        None, "Select only real or only simulated experiments.", "--real/--simulated"
    ),
    where: list[str] | None = option(
        None,
        'Select experiments that match, such as "surface=abs error>5 real"; may be repeated.',
        metavar="FILTER",
    ),
    flag: str | None = option(None, "Select only experiments with this flag.", metavar="NAME"),
    flagged: bool = option(False, "Include experiments whose data have faults.", "--all"),
    deleted: bool = option(False, "Select only deleted experiments.", "--deleted"),
    limit: int = option(MAX_ROWS, "Maximum number of rows.", min=1),
    as_json: AsJson = False,
) -> None:
    """List experiments."""
    from fixel.database.project import Project
    from fixel.model.selection import parse_filter
    from fixel.workflows.project.importing import list_experiments

    project = Project(folder)
    marks = {"real": real is True, "simulated": real is False, "deleted": deleted}
    query = parse_filter(
        *(where or ()),
        dataset=dataset,
        name=name,
        flags=() if flag is None else (flag,),
        marks=tuple(mark for mark, chosen in marks.items() if chosen),
        include_faulty=flagged,
        limit=limit,
    )
    listing = list_experiments(project, query)

    def lines() -> list[str]:
        with project.store() as store:
            datasets, flags = store.datasets(), store.flags()
        found = _listed(listing)
        if datasets and not any((dataset, name, where, flag)):
            found.append("datasets: " + ", ".join(f"{k} {n}" for k, n in datasets.items()))
        if flags and not flag:
            found.append("flags:    " + ", ".join(f"{k} {n}" for k, n in flags.items()))
        return [*found, f"Next: {_next(listing, folder, deleted)}"]

    print_answer(as_json, lambda: _content(listing), lines)


def _next(listing: "ExperimentPage", folder: Path, deleted: bool) -> str:
    if listing.rows:
        key = f"id:{listing.rows[0].id}" if deleted else listing.rows[0].key
        return command_of("show", key, *project_words(folder), "--plot", "run.png")
    return command_of("testbed", "run", "--limit", 30, project=folder)


def _listed(listing: "ExperimentPage") -> list[str]:
    columns = (
        *("id", "experiment", "", "frames", Column("time", "s", ".2f")),
        *(Column("moved", "mm", ".1f"), Column("turned", "deg", ".1f"), "contacts"),
    )
    rows = [_row(row) for row in listing.rows]
    lines = Table(columns, rows, left=3).lines() if rows else []
    more = listing.total - len(rows)
    lines.append(counted(listing.total, "experiment") + (f", {more} not shown" if more else ""))
    if listing.left_out:
        lines[-1] += (
            f"; {listing.left_out} with faults in their data are not listed (--all lists them)"
        )
    return lines


def _row(row: "ExperimentRow") -> tuple[str | float, ...]:
    return (
        row.id,
        row.key,
        "" if row.is_real else "SIMULATED",
        row.n_frame,
        row.duration_s,
        1e3 * row.moved_m,
        degrees(row.turned_rad),
        row.contact_mode,
    )


def _content(listing: "ExperimentPage") -> dict[str, Any]:
    experiments = []
    for row in listing.rows:
        content = row._asdict()
        del content["conditions_json"]
        experiments.append(content | {"conditions": row.conditions})
    return {"experiments": experiments, "total": listing.total, "left_out": listing.left_out}


@with_options
def export(
    *,
    paths: list[Path] = required(
        "TARGET: .zip file that another project can import; with --parquet, --lerobot or --to, a "
        "new folder. PROJECT: same as --project. SCENE: scene file, with --to.",
        metavar="[PROJECT|SCENE] TARGET",
        show_default=False,
    ),
    folder: ProjectFolder = Path(),
    dataset: str | None = option(None, "Select only experiments of this dataset.", metavar="NAME"),
    parquet: bool = option(False, "Write two Parquet tables: experiments and frames.", "--parquet"),
    lerobot: bool = option(False, "Write a LeRobot dataset of version 3.0.", "--lerobot"),
    fps: int | None = option(
        None,
        "Frame rate of the LeRobot dataset [Hz]; by default that of most experiments.",
        metavar="HZ",
    ),
    to: str | None = option(
        None,
        "Write a model for another engine: mujoco, drake, pymunk or box2d, with choices as in "
        "mujoco:step=0.001; or urdf. Or write a recording: mcap or rerun.",
        metavar="ENGINE",
    ),
    calibration: int | None = option(
        None,
        "Stored calibration whose first experiment is written, with --to.",
        metavar="ID",
        show_default="the newest for several experiments",
    ),
    scenes: int | None = option(
        None, "Number of scenes compared with those of the engine, with --to; 100 by default."
    ),
    seed: int | None = option(None, "Seed of the random numbers, with --to; 0 by default.", min=0),
    as_json: AsJson = False,
) -> None:
    """Export experiments, or a scene as a model for an engine."""
    from fixel.database.project import Project

    *places, target = paths
    if len(places) > 1:
        raise InvalidInput("TARGET", found=f"{len(paths)} paths", expected="[PROJECT] TARGET")
    place = places[0] if places else None
    for_model: dict[str, Any] = {"calibration": calibration, "scenes": scenes, "seed": seed}
    _check_export(to, parquet, lerobot, for_model, dataset=dataset, fps=fps)
    if to is not None:
        from fixel.workflows.model_export.run import export_model

        what = place if place and not place.is_dir() else Project(project_at(place, folder))
        model = export_model(
            what, target, to=to, progress=not as_json,
            **{name: value for name, value in for_model.items() if value is not None},
        )  # fmt: skip
        print_answer(as_json, model.summary, lambda: _exported_model(model))
        return
    kind = "parquet" if parquet else "lerobot" if lerobot else "bundle"
    project = Project(project_at(place, folder))
    answer = project.export(target, format=kind, dataset=dataset, fps=fps)
    check = command_of("import", target, "--dry-run", project=project.folder)
    following = check if kind == "bundle" else SEE_EXPORT
    print_answer(as_json, answer.summary, lambda: [*_exported(answer), f"Next: {following}"])


def _check_export(
    to: str | None, parquet: bool, lerobot: bool, for_model: Mapping[str, object], **given: object
) -> None:
    """Raise for options that the chosen kind of export does not use."""
    if parquet and lerobot:
        raise InvalidInput("--parquet", found="--parquet and --lerobot", expected="one of them")
    for name, value in {**given, **for_model, "parquet": parquet, "lerobot": lerobot}.items():
        if value is not None and value is not False and (name in for_model) == (to is None):
            found = "no --to" if to is None else "--to too"
            raise InvalidInput(f"--{name}", found=found, expected="options of one kind of export")


def _exported_model(answer: "ModelExport") -> list[str]:
    card = answer.card
    apart, errors = card["distance_from_fixel"], card.get("errors_on_experiments")
    lines = [f"{answer.to}: {card['source']['name']}"]
    lines += [f"not in the model: {text}" for text in card["not_in_the_model"]]
    if apart is not None:
        lines.append(f"end poses differ from those of fixel by {_distances(apart)}")
    if errors is not None:
        which = "held-out experiments" if errors["held_out"] else "the experiments"
        for name in (card["to"], "fixel"):
            lines.append(f"error of {name} on {which}: {_distances(errors[name])}")
    script = answer.folder / "run.py"
    following = shlex.join(["python", str(script)]) if script.exists() else SEE_EXPORT
    lines += wrote([answer.folder / name for name in answer.files])
    return [*lines, f"Next: {following}"]


def _distances(stated: Mapping[str, Any]) -> str:
    n, failures = stated["simulations"], stated["failures"]
    failed = f", {failures} of {n} simulations failed" if failures else ""
    if stated["position_mm"] is None:
        return f"no value{failed}"
    shown = [
        f"{stated['position_mm'][name]:.3g} mm and {stated['angle_deg'][name]:.3g} deg ({text})"
        for name, text in (("median", "median"), ("quantile_90", "90 % quantile"))
    ]
    return ", ".join(shown) + failed


def _records(counts: Mapping[str, int]) -> list[str]:
    """Return the number of records of each kind as text, without kinds that have none."""
    one = {"analyses": "analysis"}
    kinds = {kind: kind.replace("_", " ") for kind, n in counts.items() if n}
    return [
        f"{counts[kind]} {one.get(kind, name.removesuffix('s')) if counts[kind] == 1 else name}"
        for kind, name in kinds.items()
    ]


def _exported(answer: "ExportAnswer") -> list[str]:
    counts = dict(answer.counts)
    total = counts.pop("experiments")
    about = _records({what: counts.pop(what, 0) for what in ("flagged", "simulated", "replaced")})
    more = _records(counts)
    reasons = {
        "deleted": "deleted",
        "calibrations": "calibrations that use experiments which are not exported",
    }
    return [
        counted(total, "experiment") + (f", of them {', '.join(about)}" if about else ""),
        *([f"with {', '.join(more)}"] if more else []),
        *(f"skipped: {n} {reasons[what]}" for what, n in answer.left_out.items()),
        f"wrote {answer.target}, {answer.bytes / 1e6:.3g} MB in {time_text(answer.seconds)}",
    ]


@with_options
def data(
    *,
    url: str | None = argument(None, "URL of a file to download.", metavar="[URL]"),
    output: Path | None = option(
        None, "File or folder to write.", "--output", "-o", metavar="FOLDER", show_default="data"
    ),
    sha256: str | None = option(None, "Expected SHA-256 checksum.", "--sha256", metavar="DIGITS"),
    as_json: AsJson = False,
) -> None:
    """List public datasets; with a URL, download a file."""
    from fixel.workflows.project.importing import datasets, fetch

    if url is None:
        if unused := "output" if output else "sha256" if sha256 else "":
            raise InvalidInput(f"--{unused}", found="no URL", expected="the URL of a file")
        known = datasets()
        print_answer(as_json, lambda: {"datasets": known}, lambda: _datasets(known))
        return
    found = fetch(url, output or Path("data"), sha256)
    size = found.n_byte
    if sha256 is None and not as_json:
        notify("No checksum was given; compare this one with that of the publisher.")
    print_answer(
        as_json,
        lambda: {"file": str(found.file), "sha256": found.sha256, "bytes": size},
        lambda: [
            f"downloaded {found.file}, {size / 1e6:.3g} MB, sha256 {found.sha256}",
            f"Next: {command_of('import', found.file, '--dry-run')}",
        ],
    )


def _datasets(known: list[dict[str, str]]) -> list[str]:
    lines = [
        f"{entry['name']}\n  {entry['title']}\n"
        f"  licence: {entry['licence']}\n  cite: {entry['citation']}"
        for entry in known
    ]
    lines.append(
        "Download a file with fixel data URL --sha256 DIGITS; import it with fixel import FILE."
    )
    return [*lines, "Next: fixel import --help"]
