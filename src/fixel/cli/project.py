"""`fixel new`, `import`, `list`, `export` and `data`: a laboratory's project folder."""

import shlex
from collections.abc import Mapping, Sequence
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from fixel.capability.capability import named
from fixel.capability.options import Dataset, Door, Flagged, Where
from fixel.cli import screen
from fixel.cli.capability import command
from fixel.errors import InvalidInput, counted, plain
from fixel.progress import show_progress, time_text
from fixel.table import Column, Table, shortened
from fixel.units import length_unit

if TYPE_CHECKING:
    from fixel.database.project import AddSummary, Project
    from fixel.database.query import ExperimentPage
    from fixel.model.selection import ExperimentRow
    from fixel.workflows.model_export.run import ModelExport
    from fixel.workflows.project.export import ExportAnswer

MAX_ROWS = 30
SEE_EXPORT = "fixel export --help"


@command
def new(
    folder: Annotated[Path, Door(metavar="FOLDER", meaning="Folder of the new project.")],
    *,
    database: Annotated[str | None, Door(metavar="URL")] = None,
) -> screen.CommandAnswer:
    """Create a project folder with settings, database and media.

    Parameters
    ----------
    database : str, optional
        Database of a server, instead of a file: postgresql+psycopg://USER@HOST/NAME.
    """
    from fixel.database.project import Project

    name = Project.create(folder, database=database).settings.name
    lines = [
        f"created project {name} in {folder}",
        "Import recorded experiments with fixel import SOURCE, or try simulated ones:",
        f"Next: {screen.command_of('testbed', 'run', '--limit', 30, '--project', folder)}",
    ]
    return screen.CommandAnswer({"folder": str(folder), "name": name}, lines)


@command
def import_(
    project: Path,
    source: Annotated[Path, Door(metavar="SOURCE", meaning="File or folder to import.")],
    *,
    format: Annotated[str | None, Door(flag="--as", metavar="NAME")] = None,
    option: Annotated[Mapping[str, str] | None, Door(metavar="NAME=VALUE")] = None,
    scene: Path | None = None,
    dry_run: Annotated[bool, Door(flag="--dry-run")] = False,
    as_json: bool,
) -> screen.CommandAnswer:
    """Import recorded experiments, and skip stored ones.

    Parameters
    ----------
    format : str, optional
        Name of the importer; by default it is recognised.
    option : mapping of str to str, optional
        Option of the importer, such as split_by=push; may be repeated. A wrong name lists all.
    scene : Path, optional
        Scene file for a CSV table, with object, pusher and fixels. Without one, a template is
        written next to the table.
    dry_run : bool
        Print how the source is read; import nothing.
    """
    from fixel.database.project import Project
    from fixel.datasets import plan_import
    from fixel.workflows.project.importing import write_template

    if source.suffix.lower() == ".zip" and format is None:
        if unused := "scene" if scene else "option" if option else "":
            raise InvalidInput(unused, found="a bundle", expected="a table or a dataset")
        return _import_bundle(Project(project), source, dry_run)
    own = None if dry_run else Project(project)
    try:
        plan = plan_import(source, format, scene=scene, options=option, progress=None)
    except InvalidInput as error:
        flags = {name: f"--option {name}" for name in (*(option or ()), "split_by", "object_name")}
        raise named(error, flags) from None
    content: dict[str, Any] = {
        "importer": plan.importer,
        "source": str(source),
        "experiments": plan.n_experiments,
        "understood": list(plan.understood),
    }
    experiments = counted(plan.n_experiments, "experiment")
    lines = [f"{source}: {experiments}, read as {plan.importer}"]
    lines += [f"  {sentence}" for sentence in plan.understood]
    if own is None:
        content["experiments"] = sum(1 for _ in plan)
        content["skipped"] = list(plan.skipped)
        following = f"Next: {screen.command_line(without='--dry-run')}"
        return screen.CommandAnswer(content, [*lines, *_skipped(plan.skipped), following])
    if not as_json:  # before the import, which may take long
        print(plain("\n".join(lines)), flush=True)
    done = own.add(plan)
    content["skipped"] = list(plan.skipped)
    template = write_template(plan, own.folder)
    if template is not None:
        content |= {
            "template": str(template),
            "next": f"{screen.command_line()} --scene {shlex.quote(str(template))}",
        }
    return imported(done, content, own.folder)


def _skipped(names: Sequence[str]) -> list[str]:
    """List what an import left out, with the reasons."""
    lines = shortened([f"  {name}" for name in names[:MAX_ROWS]], len(names), "  ")
    return [f"skipped {len(names)}:", *lines] if names else []


def _import_bundle(project: "Project", source: Path, dry_run: bool) -> screen.CommandAnswer:
    """Import the bundle that another project exported."""
    from fixel.workflows.project.export import import_zip

    with show_progress(stage="importing") as report:
        counts = import_zip(project, source, report, dry_run=dry_run)
    n, found = counts.get("known"), ", ".join(_records({**counts, "known": 0})) or "nothing"
    found += f"; {n} {'was' if n == 1 else 'were'} already stored" if n else ""
    verb = "contains" if dry_run else "added"
    listing = screen.command_of("list", project=project.folder)
    following = screen.command_line("--dry-run") if dry_run else listing
    content = {"source": str(source), "dry_run": dry_run, **counts}
    return screen.CommandAnswer(content, [f"{source}: {verb} {found}", f"Next: {following}"])


def imported(done: "AddSummary", content: dict[str, Any], folder: Path) -> screen.CommandAnswer:
    """Report how many were stored; `content` is more for JSON."""
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
    if done.replaced:
        many = counted(done.replaced, "earlier experiment")
        lines.append(
            f"replaced {many} of the same name; fixel list --where replaced lists these, too"
        )
    if done.faulty:
        lines.append(
            f"{done.faulty} of them have faults in their data; list them with fixel list --all"
        )
    following = content.get("next", screen.command_of("list", project=folder))
    return screen.CommandAnswer(content | done._asdict(), [*lines, f"Next: {following}"])


@command
def list_(
    project: "Project",
    *,
    dataset: Dataset = "",
    name: Annotated[str, Door(metavar="PATTERN")] = "",
    real: Annotated[bool | None, Door(flag="--real/--simulated")] = None,
    where: Where = (),
    flag: Annotated[str, Door(metavar="NAME")] = "",
    flagged: Flagged = False,
    deleted: Annotated[bool, Door(flag="--deleted")] = False,
    limit: Annotated[int, Door(least=1)] = MAX_ROWS,
) -> screen.CommandAnswer:
    """List experiments.

    Parameters
    ----------
    name : str
        Select names that match this pattern; * matches any text.
    real : bool, optional
        Select only real or only simulated experiments.
    flag : str
        Select only experiments with this flag.
    deleted : bool
        Select only deleted experiments.
    limit : int
        Maximum number of rows.
    """
    from fixel.model.selection import parse_filter
    from fixel.workflows.project.importing import list_experiments

    marks = {"real": real is True, "simulated": real is False, "deleted": deleted}
    query = parse_filter(
        *where,
        dataset=dataset or None,
        name=name or None,
        flags=(flag,) if flag else (),
        marks=tuple(mark for mark, chosen in marks.items() if chosen),
        include_faulty=flagged,
        limit=limit,
    )
    listing = list_experiments(project, query)
    with project.store() as store:
        datasets, flags = store.datasets(), store.flags()
    lines = _listed(listing)
    if datasets and not any((dataset, name, where, flag)):
        lines.append("datasets: " + ", ".join(f"{k} {n}" for k, n in datasets.items()))
    if flags and not flag:
        lines.append("flags:    " + ", ".join(f"{k} {n}" for k, n in flags.items()))
    return screen.CommandAnswer(
        _content(listing), [*lines, f"Next: {_next(listing, project.folder, deleted)}"]
    )


def _next(listing: "ExperimentPage", folder: Path, deleted: bool) -> str:
    if listing.rows:
        key = f"id:{listing.rows[0].id}" if deleted else listing.rows[0].key
        return screen.command_of("show", key, *screen.project_words(folder), "--plot", "run.png")
    return screen.command_of("testbed", "run", "--limit", 30, project=folder)


def _listed(listing: "ExperimentPage") -> list[str]:
    unit, metre = length_unit(max((row.moved_m for row in listing.rows), default=0.0))
    columns = (
        *("id", "experiment", "", "frames", Column("time", "s", ".2f")),
        *(Column("moved", unit, ".1f"), Column("turned", "deg", ".1f"), "contacts"),
    )
    rows = [_row(row, metre) for row in listing.rows]
    lines = Table(columns, rows, left=3).lines() if rows else []
    more = listing.total - len(rows)
    lines.append(counted(listing.total, "experiment") + (f", {more} not shown" if more else ""))
    if listing.left_out:
        lines[-1] += (
            f"; {listing.left_out} with faults in their data are not listed (--all lists them)"
        )
    return lines


def _row(row: "ExperimentRow", metre: float) -> tuple[str | float, ...]:
    return (
        row.id,
        row.key,
        "" if row.is_real else "SIMULATED",
        row.n_frame,
        row.duration_s,
        row.moved_m / metre,
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


@command
def export(
    project: Path,
    paths: Annotated[tuple[Path, ...], Door(metavar="[PROJECT|SCENE] TARGET")],
    *,
    dataset: Dataset = "",
    parquet: Annotated[bool, Door(flag="--parquet")] = False,
    lerobot: Annotated[bool, Door(flag="--lerobot")] = False,
    fps: Annotated[int | None, Door(metavar="HZ")] = None,
    to: Annotated[str | None, Door(metavar="ENGINE")] = None,
    calibration: Annotated[
        int | None, Door(metavar="ID", usual="the newest for several experiments")
    ] = None,
    scenes: int | None = None,
    seed: Annotated[int | None, Door(least=0)] = None,
) -> screen.CommandAnswer:
    """Export experiments, or a scene as a model for an engine.

    Parameters
    ----------
    paths : tuple of Path
        TARGET: .zip file that another project can import; with --parquet, --lerobot or --to, a new
        folder. PROJECT: same as --project. SCENE: scene file, with --to.
    parquet : bool
        Write two Parquet tables: experiments and frames.
    lerobot : bool
        Write a LeRobot dataset of version 3.0.
    fps : int, optional
        Frame rate of the LeRobot dataset [Hz]; by default that of most experiments.
    to : str, optional
        Write a model for another engine: mujoco, drake, pymunk or box2d, with choices as in
        mujoco:step=0.001; or urdf. Or write a recording: mcap or rerun.
    calibration : int, optional
        Stored calibration whose first experiment is written, with --to.
    scenes : int, optional
        Number of scenes compared with those of the engine, with --to; 100 by default.
    seed : int, optional
        Seed of the random numbers, with --to; 0 by default.
    """
    *places, target = paths
    if len(places) > 1:
        raise InvalidInput("TARGET", found=f"{len(paths)} paths", expected="[PROJECT] TARGET")
    place = places[0] if places else None
    for_model = {"calibration": calibration, "scenes": scenes, "seed": seed}
    others = {"dataset": dataset, "fps": fps, "parquet": parquet, "lerobot": lerobot}
    if parquet and lerobot:
        raise InvalidInput("parquet", found="--parquet and --lerobot", expected="one of them")
    for name, value in (for_model if to is None else others).items():
        if value is not None and value is not False and value != "":
            found = "no --to" if to is None else "--to too"
            raise InvalidInput(name, found=found, expected="options of one kind of export")
    if to is not None:
        from fixel.workflows.model_export.run import export_model

        what = place if place and not place.is_dir() else screen.project_at(place, project)
        given: Any = {name: value for name, value in for_model.items() if value is not None}
        model = export_model(what, target, to=to, **given)
        return screen.CommandAnswer(model.summary(), _exported_model(model))
    kind = "parquet" if parquet else "lerobot" if lerobot else "bundle"
    source = screen.project_at(place, project)
    answer = source.export(target, format=kind, dataset=dataset or None, fps=fps)
    check = screen.command_of("import", target, "--dry-run", project=source.folder)
    following = check if kind == "bundle" else SEE_EXPORT
    return screen.CommandAnswer(answer.summary(), [*_exported(answer), f"Next: {following}"])


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
    lines += screen.wrote([answer.folder / name for name in answer.files])
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


@command
def data(
    url: Annotated[str | None, Door(metavar="URL", meaning="URL of a file to download.")] = None,
    *,
    output: Annotated[Path | None, Door(also=("-o",), metavar="FOLDER", usual="data")] = None,
    sha256: Annotated[str | None, Door(metavar="DIGITS")] = None,
) -> screen.CommandAnswer:
    """List public datasets; with a URL, download a file.

    Parameters
    ----------
    output : Path, optional
        File or folder to write.
    sha256 : str, optional
        Expected SHA-256 checksum.
    """
    from fixel.workflows.project.importing import datasets, fetch

    if url is None:
        if unused := "output" if output else "sha256" if sha256 else "":
            raise InvalidInput(unused, found="no URL", expected="the URL of a file")
        known = datasets()
        return screen.CommandAnswer({"datasets": known}, _datasets(known))
    file, digest = fetch(url, output or Path("data"), sha256)
    size = file.stat().st_size
    if sha256 is None:
        screen.notify("No checksum was given; compare this one with that of the publisher.")
    lines = [
        f"downloaded {file}, {size / 1e6:.3g} MB, sha256 {digest}",
        f"Next: {screen.command_of('import', file, '--dry-run')}",
    ]
    return screen.CommandAnswer({"file": str(file), "sha256": digest, "bytes": size}, lines)


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
