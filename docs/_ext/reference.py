"""Reference pages that are written from the package itself when the site is built.

Each is written only when it differs, so that Sphinx reads again what changed and nothing else.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path

import typer

import fixel
from fixel.cli.main import SECTIONS, app
from fixel.formats import scene_json_schema
from fixel.model import KNOWN_PARAMETERS

# Public names in the order of the reference; names that are in none come last.
GROUPS = {
    "Scenes": "Scene Body Pusher Fixel Polygon Disk Tripod SupportPoints UniformPressure Ellipsoid"
    " NoSupport LineDrive PathDrive PairFriction Plane LoadMap Pose Parameters load_scene",
    "Simulation": "simulate simulate_batch Simulator Simulation BatchResult Trajectory Dynamic"
    " QuasiStatic FirstOrder Adaptive StewartTrinkle Newton Lemke GaussSeidel",
    "Experiments": "read_experiments Experiment Experiments PlannedExperiment SimulatedTestbed"
    " Project export report load",
    "Calibration": "calibrate calibrate_each calibrate_campaign known_parameters Parameter"
    " Calibration Calibrations Estimate Noise",
    "Comparison and trust": "compare Comparison map_domain DomainMap error_bound ErrorBound"
    " sensitivity Sensitivity posterior Posterior predict Prediction filter FilterRun StartError"
    " part_model PartModel table_check TableCheck table_map TableMap",
    "Planning": "plan PushPlan FreePushes RigPushes Belief RigError run_on_testbed orienting_plan"
    " OrientingPlan push_candidates NextPushes",
    "Goals": "PoseRegion Seated Inside Beyond AllOf AnyOf Contact Exit ForceAbove Goal",
    "Errors": "FixelError InvalidInput SolveFailed StoreRefused MissingExtra Interrupted",
}


def write_pages(folder: Path) -> None:
    """Write the generated pages of the reference into a folder."""
    pages = {
        "api.rst": api(),
        "generated/scene-keys.md": scene_keys(),
        "generated/parameters.md": parameters(),
        **{f"commands/{name}.md": text for name, text in commands()},
    }
    for name, text in pages.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
    for page in (folder / "commands").glob("*.md"):
        if f"commands/{page.name}" not in pages:
            page.unlink()


def public_names() -> list[str]:
    """Return the public names of the package, also `filter`, which a star import leaves out."""
    names = {*fixel.__all__, "filter"} - {"__version__"}
    return sorted(name for name in names if hasattr(fixel, name))


def members_by_home() -> dict[str, str]:
    """Return the names of members of public classes, by where their classes are defined."""
    classes = {name: getattr(fixel, name) for name in public_names()}
    return {
        f"{own.__module__}.{own.__qualname__}.{member}": f"fixel.{name}.{member}"
        for name, own in classes.items()
        if isinstance(own, type)
        for member in dir(own)
        if not member.startswith("_")
    }


def api() -> str:
    """Return the page of public names, by groups."""
    public = public_names()
    groups = {title: [n for n in names.split() if n in public] for title, names in GROUPS.items()}
    grouped = {name for names in groups.values() for name in names}
    groups["Others"] = [name for name in public if name not in grouped]
    lines = [
        "Python API",
        "==========",
        "",
        "All names are imported from ``fixel``. Numbers are in SI units and angles in radians,",
        "unless a name says otherwise.",
        "",
        ".. currentmodule:: fixel",
    ]
    for title, names in groups.items():
        if names:
            lines += ["", title, "-" * len(title), "", ".. autosummary::", "   :toctree: api"]
            lines += ["   :nosignatures:", "", *(f"   {name}" for name in names)]
    return "\n".join([*lines, ""])


def commands() -> Iterator[tuple[str, str]]:
    """Yield name and text of a page for each command, and of their index."""
    group = typer.main.get_command(app)
    index = ["# Commands", "", *_paragraphs(group.help), ""]
    exits = [
        "| Exit code | Meaning |",
        "|---|---|",
        "| 0 | done |",
        "| 1 | another failure; the message is on standard error |",
        "| 2 | bad input: a wrong option, or an invalid scene or dataset |",
        "| 3 | the simulation did not finish; the answer holds what was computed until then |",
        "| 4 | `fixel overlay --once`: a part is not in its place |",
        "| 130 | interrupted |",
        "",
        "With `--json` the answer, or the error, is one JSON object on standard output.",
    ]
    for title, names in SECTIONS.items():
        index += ["", f"## {title}", "", "| Command | Purpose |", "|---|---|"]
        for name in names:
            command = group.commands[name]
            index.append(f"| [`fixel {name}`]({name}.md) | {_summary(command)} |")
            yield name, "\n".join(_command(command, ["fixel", name])) + "\n"
        index += ["", "```{toctree}", ":hidden:", "", *names, "```"]
    yield "index", "\n".join([*index, "", "## Exit codes", "", *exits, ""])


def _command(command: typer.core.TyperCommand, path: list[str], level: int = 1) -> Iterator[str]:
    context = command.context_class(command, info_name=" ".join(path))
    usage = " ".join(command.collect_usage_pieces(context))
    yield from [f"{'#' * level} {' '.join(path)}", "", *_paragraphs(command.help)]
    yield from ["```text", f"{' '.join(path)} {usage}", "```", ""]
    records = [
        record
        for param in command.get_params(context)
        if param.name != "help" and (record := param.get_help_record(context))
    ]
    if records:
        yield from ["| Argument or option | Meaning |", "|---|---|"]
        yield from (f"| {_code(name)} | {_cell(text)} |" for name, text in records)
        yield ""
    for name, child in getattr(command, "commands", {}).items():
        if not child.hidden:
            yield from _command(child, [*path, name], level + 1)


def scene_keys() -> str:
    """Return tables of the keys of a scene file, from its schema."""
    schema = scene_json_schema()
    lines = []
    for title, record in {"Scene": schema, **schema["$defs"]}.items():
        name = title.removesuffix("Record")
        if not record.get("properties"):
            continue
        lines += [f"### {name}", "", "| Key | Type | Meaning | Default |", "|---|---|---|---|"]
        required = record.get("required", ())
        for key, value in record["properties"].items():
            default = "required" if key in required else _default(value.get("default"))
            meaning = _cell(value.get("description", ""))
            lines.append(f"| `{key}` | {_kind(value)} | {meaning} | {default} |")
        lines.append("")
    return "\n".join(lines)


def parameters() -> str:
    """Return the table of named parameters."""
    lines = ["| Name | Unit | Meaning | Smallest value |", "|---|---|---|---|"]
    for name, info in KNOWN_PARAMETERS.items():
        low = "any" if info.lowest == float("-inf") else f"{info.lowest:g}"
        low = f"above {low}" if info.above else low
        lines.append(f"| `{name}` | {info.unit} | {_cell(info.meaning)} | {low} |")
    return "\n".join([*lines, ""])


def _kind(value: Mapping) -> str:
    """Return the type of a key, with links to the tables of records."""
    if "$ref" in value:
        name = value["$ref"].rpartition("/")[2].removesuffix("Record")
        return f"[{name}](#{name.lower()})" if name != "NoSupport" else "empty"
    if "anyOf" in value:
        return " or ".join(_kind(form) for form in value["anyOf"] if form.get("type") != "null")
    if "enum" in value or "const" in value:
        return ", ".join(f"`{one}`" for one in value.get("enum", [value.get("const")]))
    if value.get("type") == "array":
        fixed = value.get("minItems")
        count = f"{fixed} × " if fixed and fixed == value.get("maxItems") else "list of "
        return count + _kind(value.get("items", {}))
    limits = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
    bounds = " and ".join(f"{sign} {value[key]:g}" for key, sign in limits.items() if key in value)
    return f"{value.get('type', 'object')} {bounds}".strip()


def _default(value: object) -> str:
    return "-" if value is None else f"`{value}`"


def _summary(command: typer.core.TyperCommand) -> str:
    return _cell((command.help or "").strip().split("\n\n")[0])


def _paragraphs(text: str | None) -> list[str]:
    lines = (text or "").strip().replace("<", r"\<").splitlines()
    return [*(line.strip() for line in lines), ""]


def _cell(text: str) -> str:
    """Return text that stays one cell of a Markdown table."""
    for mark in "\\<>|*_[]":
        text = text.replace(mark, f"\\{mark}")
    return " ".join(text.split())


def _code(text: str) -> str:
    return "`" + " ".join(text.split()).replace("|", "\\|") + "`"
