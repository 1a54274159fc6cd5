"""`fixel camera`: calibrate, import, place and check a camera; print boards and tags."""

import json
import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fixel.cli.options import AsJson
from fixel.errors import InvalidInput

if TYPE_CHECKING:
    from fixel.workflows.camera.calibrate import CameraAnswer

MOST_ROWS = 40

app = typer.Typer(
    help="Calibrate, import, place and check a camera; print boards and tags.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

BoardOption = Annotated[
    str | None,
    typer.Option(
        help="charuco:7x5:30mm:22mm (squares, size, size of tags) or checkerboard:9x6:25mm "
        "(inner corners, size of squares).",
        metavar="BOARD",
    ),
]
Heights = Annotated[
    list[float] | None,
    typer.Option(
        "--height-mm",
        help="Above the plate, for which to say how right places are; may be repeated.",
        show_default="0 and 25.4",
    ),
]
Plot = Annotated[
    Path | None,
    typer.Option(help="Map of errors at the first height: .png, .svg or .pdf.", metavar="FILE"),
]
Paper = Annotated[str, typer.Option(help="a4, a3, a2 or letter.")]
CameraFile = Annotated[
    Path, typer.Argument(help="Camera file.", metavar="CAMERA", exists=True, dir_okay=False)
]
THESIS_HEIGHTS = (0.0, 25.4)  # [mm] plate, upper face of the object


@app.command("calibrate")
def calibrate(
    pictures: Annotated[
        list[Path],
        typer.Argument(
            help="Pictures of a board, folders of them, or a video.",
            metavar="PICTURES...",
            exists=True,
        ),
    ],
    board: BoardOption = None,
    out: Annotated[Path, typer.Option(help="Camera file to write.", metavar="FILE")] = Path(
        "camera.yaml"
    ),
    coefficients: Annotated[int, typer.Option(help="Of the distortion: 0, 1, 2, 4, 5 or 8.")] = 4,
    fisheye: Annotated[
        bool, typer.Option("--fisheye", help="For lenses wider than about 120 degrees.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Calibrate a lens from 10 to 20 pictures of a board."""
    from fixel.cli.screen import counting_bar
    from fixel.workflows.camera.calibrate import calibrate as run

    if board is None:
        raise InvalidInput(
            "--board",
            found=None,
            expected="the board in the pictures: charuco:7x5:30mm:22mm or checkerboard:9x6:25mm",
            hint="to print one: fixel camera board",
        )
    with counting_bar() as tell:
        answer = run(pictures, board, out, coefficients=coefficients, fisheye=fisheye, tell=tell)
    _show(
        answer.summary(),
        [_lens(answer), _views(answer), _corners(answer)],
        [out],
        f"fixel camera place {_quoted(out)} PICTURE --board {board}, a picture of the board flat "
        "on the plate",
        as_json,
    )


@app.command("import")
def import_(
    file: Annotated[
        Path,
        typer.Argument(
            help="Calib_Results.m or .mat, OpenCV's storage, Kalibr's camchain, ROS's camera_info.",
            metavar="FILE",
            exists=True,
            dir_okay=False,
        ),
    ],
    out: Annotated[Path, typer.Option(help="Camera file to write.", metavar="FILE")] = Path(
        "camera.yaml"
    ),
    format: Annotated[str, typer.Option(help="auto, matlab, opencv, kalibr or ros.")] = "auto",
    size: Annotated[
        str | None,
        typer.Option(
            help="Of your pictures, 1280x720: refused if the file is for others.", metavar="WxH"
        ),
    ] = None,
    which: Annotated[
        str, typer.Option(help="Of several cameras in a Kalibr file.", metavar="cam0")
    ] = "",
    unit: Annotated[str, typer.Option(help="Of lengths in a MATLAB file: mm, cm or m.")] = "mm",
    as_json: AsJson = False,
) -> None:
    """Take over a camera that another program calibrated."""
    from fixel.workflows.camera.calibrate import bring_in

    units = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
    if unit not in units:
        raise InvalidInput("--unit", found=repr(unit), expected="mm, cm or m")
    answer = bring_in(file, out, format=format, size=_size(size), which=which, unit=units[unit])
    placed = answer.camera.camera is not None
    _show(
        answer.summary(),
        [_lens(answer), _remarks(answer)],
        [out],
        f"fixel camera check {_quoted(out)}"
        if placed
        else f"fixel camera place {_quoted(out)} PICTURE --board charuco:7x5:30mm:22mm",
        as_json,
    )


@app.command("export")
def export(
    camera: CameraFile,
    out: Annotated[Path, typer.Option(help="File to write.", metavar="FILE")],
    format: Annotated[str, typer.Option(help="opencv or ros.")] = "opencv",
    as_json: AsJson = False,
) -> None:
    """Write a lens as OpenCV or ROS has it."""
    from fixel.workflows.camera.calibrate import export as run

    answer = run(camera, out, format)
    _show(answer.summary(), [_lens(answer)], [out], "", as_json)


@app.command("place")
def place(
    camera: CameraFile,
    picture: Annotated[
        Path,
        typer.Argument(
            help="Picture of the plate, or a video whose first frame is taken.",
            metavar="PICTURE",
            exists=True,
        ),
    ],
    board: BoardOption = None,
    at: Annotated[
        str,
        typer.Option(
            help="Where the board's lower left corner lies in the world: x, y [mm], angle [deg].",
            metavar="X,Y,ANGLE",
        ),
    ] = "0,0,0",
    thickness_mm: Annotated[
        float, typer.Option(help="Of the board, above the plate [mm].", min=0.0)
    ] = 0.0,
    rig: Annotated[
        str | None,
        typer.Option(help="Rig whose tags are on the plate, in place of a board.", metavar="RIG"),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Camera file to write.", metavar="FILE", show_default="CAMERA-placed"),
    ] = None,
    height_mm: Heights = None,
    plot: Plot = None,
    as_json: AsJson = False,
) -> None:
    """Find where a camera is above the plate, and how right places on it are."""
    from fixel.workflows.camera.calibrate import place as run

    target = out or camera.with_name(f"{camera.stem}-placed.yaml")
    answer = run(
        camera,
        picture,
        target,
        board=board,
        at=_pose(at),
        thickness=thickness_mm / 1e3,
        rig=rig,
        heights=_heights(height_mm),
        plot=plot,
    )
    _show(
        answer.summary(),
        [_place(answer), _misfit(answer), _verdicts(answer)],
        [target, plot],
        f"name {target.name} as the camera of a rig file, then fixel camera check RIG --video FILE",
        as_json,
    )


@app.command("check")
def check(
    camera: Annotated[
        str,
        typer.Argument(help="Camera file, rig file, or name of an example rig.", metavar="CAMERA"),
    ],
    video: Annotated[
        Path | None,
        typer.Option(
            help="Video or picture of the bench: is its size right, is the camera where it was?",
            metavar="FILE",
            exists=True,
        ),
    ] = None,
    height_mm: Heights = None,
    plot: Plot = None,
    as_json: AsJson = False,
) -> None:
    """Say how right places on the plate are, and whether the camera is still where it was."""
    from fixel.workflows.camera.check import check as run

    found = run(camera, video=video, heights=_heights(height_mm), plot=plot)
    tags = [
        f"tag {number} of the plate is {1e3 * off:.2f} mm from its place"
        for number, off in found.tags.items()
    ]
    trip = [f"pixels and directions agree both ways to {found.round_trip:.1g} px"]
    problems = [f"PROBLEM: {problem}" for problem in found.problems]
    _show(
        found.summary(),
        [
            _lens(found.answer),
            _place(found.answer),
            trip,
            _verdicts(found.answer),
            _remarks(found.answer),
            tags,
            problems,
        ],
        [plot],
        "" if not found.problems else f"fixel camera place {_quoted(camera)} PICTURE",
        as_json,
    )
    if found.problems:
        raise typer.Exit(1)


@app.command("board")
def board_(
    board: Annotated[
        str, typer.Argument(help="As for calibrate.", metavar="BOARD")
    ] = "charuco:7x5:30mm:22mm",
    out: Annotated[Path, typer.Option(help="Print to write: .pdf or .png.", metavar="FILE")] = Path(
        "board.pdf"
    ),
    paper: Paper = "a4",
    as_json: AsJson = False,
) -> None:
    """A board to print, true to scale."""
    from fixel.workflows.camera.prints import print_board

    answer = print_board(board, out, paper)
    _show(
        answer.summary(),
        [["Print at 100 %, measure the ruler, glue it to something flat."]],
        [out],
        f"fixel camera calibrate PICTURES... --board {answer.what}",
        as_json,
    )


@app.command("tags")
def tags(
    rig: Annotated[
        str | None,
        typer.Argument(help="Rig whose tags to print.", metavar="RIG", show_default="none"),
    ] = None,
    ids: Annotated[
        str | None, typer.Option(help="Numbers, in place of a rig: 0-9.", metavar="FIRST-LAST")
    ] = None,
    size_mm: Annotated[float, typer.Option(help="Side of the black square [mm].")] = 30.0,
    family: Annotated[
        str, typer.Option(help="apriltag-36h11, aruco-4x4-50 or aruco-5x5-100.")
    ] = "apriltag-36h11",
    out: Annotated[Path, typer.Option(help="Print to write: .pdf or .png.", metavar="FILE")] = Path(
        "tags.pdf"
    ),
    paper: Paper = "a4",
    as_json: AsJson = False,
) -> None:
    """Tags to print, true to scale: those of a rig, or some numbers."""
    from fixel.workflows.camera.prints import print_rig_tags, print_tags

    if (rig is None) == (ids is None):
        raise InvalidInput(
            "tags", found="both" if rig else "neither", expected="either a RIG or --ids 0-9"
        )
    if rig is not None:
        answer = print_rig_tags(rig, out, paper)
    else:
        first, last = _range(str(ids))
        answer = print_tags(first, last, size_mm / 1e3, family, out, paper)
    _show(
        answer.summary(),
        [
            [
                f"{answer.tags} tags on {answer.sheets} sheet{'s' if answer.sheets > 1 else ''}. "
                "Print at 100 %, measure the ruler, leave the white around each tag."
            ]
        ],
        [out],
        f"fixel camera place CAMERA PICTURE --rig {shlex.quote(rig)}" if rig else "",
        as_json,
    )


# --- what is said ---------------------------------------------------------------------------------


def _show(
    summary: dict[str, Any],
    blocks: list[list[str]],
    files: list[Path | None],
    then: str,
    as_json: bool,
) -> None:
    if as_json:
        typer.echo(json.dumps(summary, allow_nan=False))
        return
    wrote = [f"wrote {file}" for file in files if file]
    after = [f"Next: {then}"] if then else []
    everything = [*blocks, wrote, after]
    typer.echo("\n\n".join("\n".join(block) for block in everything if block))


def _lens(answer: "CameraAnswer") -> list[str]:
    camera, lens = answer.camera, answer.camera.lens
    width, height = lens.image_size
    known = camera.deviations

    def number(name: str, value: float, unit: str = " px") -> str:
        spread = f" +- {known[name]:.2g}" if name in known else ""
        return f"{name} {value:.6g}{spread}{unit}"

    names = (
        ("k1", "k2", "k3", "k4")
        if lens.fisheye
        else ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    )
    terms = [
        number(name, value, "")
        for name, value in zip(names, lens.distortion.tolist(), strict=True)
        if value or name in known
    ]
    skew = [number("skew", lens.skew, "")] if lens.skew else []
    lines = [
        f"{'fisheye' if lens.fisheye else 'lens'} for pictures of {width} x {height} px",
        "  " + ", ".join(number(n, v) for n, v in zip(("fx", "fy"), lens.focal, strict=True)),
        "  " + ", ".join(number(n, v) for n, v in zip(("cx", "cy"), lens.centre, strict=True)),
    ]
    return [*lines, "  " + ", ".join(skew + terms)] if skew or terms else lines


def _views(answer: "CameraAnswer") -> list[str]:
    from fixel.cli.screen import table

    found = answer.calibration
    assert found is not None
    rows = [
        (u.name, str(u.corners), f"{u.rms:.3f}", f"{u.tilt * 57.29578:.0f}") for u in found.used
    ]
    head = ("picture", "corners", "rms [px]", "tilt [deg]")
    left_out = [f"  {d.name}: {d.reason}" for d in found.dropped]
    return [
        *table(head, rows[:MOST_ROWS]),
        *([f"... and {len(rows) - MOST_ROWS} more"] if len(rows) > MOST_ROWS else []),
        f"{len(rows)} pictures used, rms {found.rms:.3f} px",
        *([f"left out ({len(left_out)}):", *left_out[:MOST_ROWS]] if left_out else []),
    ]


def _corners(answer: "CameraAnswer") -> list[str]:
    from fixel.workflows.camera.verdict import empty_corners

    empty = empty_corners(answer.camera.seen)
    if not empty:
        return ["Every corner of the picture had a board near."]
    return [
        f"No board was near {len(empty)} of 4 corners of the picture ({', '.join(empty)}): "
        "take more pictures there, the lens is guessed at there."
    ]


def _place(answer: "CameraAnswer") -> list[str]:
    camera = answer.camera.camera
    if camera is None:
        return []
    x, y, z = 1e3 * camera.position
    tilt = answer.camera.camera and _tilt(camera.rotation)
    return [
        f"camera {z:.1f} mm above the plate, over x {x:.1f} mm, y {y:.1f} mm, tilted by "
        f"{tilt:.1f} deg; {1e3 * camera.metres_per_pixel():.3g} mm per pixel on the plate"
    ]


def _tilt(rotation: Any) -> float:
    import math

    return math.degrees(math.acos(max(-1.0, min(1.0, -rotation[2, 2]))))


def _misfit(answer: "CameraAnswer") -> list[str]:
    found = answer.placement
    assert found is not None
    summary = answer.summary()
    return [
        f"{summary['points']} points lie {1e3 * summary['misfit_rms_m']:.2g} mm (rms), at worst "
        f"{1e3 * summary['misfit_worst_m']:.2g} mm from where they are said to be "
        f"({found.rms:.2g} px rms)"
    ]


def _verdicts(answer: "CameraAnswer") -> list[str]:
    return [f"{each.sentence}." for each in answer.verdicts]


def _remarks(answer: "CameraAnswer") -> list[str]:
    return [f"note: {remark}" for remark in answer.remarks]


# --- what is typed --------------------------------------------------------------------------------


def _heights(typed: list[float] | None) -> tuple[float, ...]:
    return tuple(mm / 1e3 for mm in (typed or THESIS_HEIGHTS))


def _pose(text: str) -> tuple[float, float, float]:
    import math

    try:
        x, y, angle = (float(part) for part in text.split(","))
    except ValueError:
        raise InvalidInput(
            "--at", found=repr(text), expected="x and y [mm] and an angle [deg]: 0,0,0"
        ) from None
    return x / 1e3, y / 1e3, math.radians(angle)


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if not found:
        raise InvalidInput("--size", found=repr(text), expected="width and height [px]: 1280x720")
    return int(found[1]), int(found[2])


def _range(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{1,4})(?:-(\d{1,4}))?", text)
    if not found:
        raise InvalidInput("--ids", found=repr(text), expected="numbers such as 0-9")
    return int(found[1]), int(found[2] or found[1])


def _quoted(path: Path | str) -> str:
    return shlex.quote(str(path))
