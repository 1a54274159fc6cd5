"""Calibrate, import, export, place and check cameras; print boards and tags."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

from fixel.capability.capability import Capability
from fixel.capability.options import Door

if TYPE_CHECKING:
    from fixel.progress import ProgressOption
    from fixel.workflows.acquisition.camera.report import CameraAnswer, PrintAnswer

USUAL_BOARD: Final = "charuco:7x5:30mm:22mm"

BOARD: Final = Door(
    metavar="BOARD",
    meaning=f"Calibration board, as fixel camera board prints: {USUAL_BOARD} (squares, their size, "
    "size of the tags) or checkerboard:9x6:25mm (inner corners, size of the squares).",
)
CameraFile = Annotated[Path, Door(metavar="CAMERA", meaning="Camera file.")]
Written = Annotated[Path, Door(meaning="Camera file to write.")]
Printed = Annotated[Path, Door(meaning="File to print: .pdf or .png.")]
Paper = Annotated[str, Door(meaning="Paper size: a4, a3, a2 or letter.")]
Height = Annotated[
    tuple[float, ...],
    Door(
        unit="mm",
        meaning="Height above the plate for which the accuracy is reported; may be repeated.",
    ),
]
Plot = Annotated[
    Path | None,
    Door(meaning="Draw a map of the position error at the first height: .png, .svg or .pdf."),
]
THESIS_HEIGHTS: Final = (0.0, 0.0254)  # [m] plate, upper face of the object
LENGTHS: Final = "5; 8 if cross-validation needs them; 4 for fewer than 8 pictures"


def calibrate_camera(
    pictures: Annotated[Sequence[Path], Door(plain=tuple[Path, ...], metavar="PICTURES")],
    *,
    board: Annotated[str, BOARD],
    out: Written = Path("camera.yaml"),
    coefficients: Annotated[int | None, Door(usual=LENGTHS)] = None,
    fisheye: bool = False,
    progress: ProgressOption = None,
) -> CameraAnswer:
    """Calibrate a lens from 10 to 20 pictures of a board.

    Parameters
    ----------
    pictures : sequence of Path
        Pictures of a board, folders of pictures, or a video.
    coefficients : int, optional
        Number of distortion coefficients: 0, 1, 2, 4, 5 or 8.
    fisheye : bool
        Use the fisheye model, for lenses wider than about 120 degrees.
    """
    from fixel.workflows.acquisition.camera import work

    return work.calibrated(CAMERA["calibrate"].asked(locals()), progress)


def import_camera(
    file: Path,
    *,
    out: Written = Path("camera.yaml"),
    format: str = "auto",
    size: Annotated[str | None, Door(metavar="WxH")] = None,
    which: Annotated[str, Door(metavar="NAME")] = "",
    unit: Literal["mm", "cm", "m"] = "mm",
    progress: ProgressOption = None,
) -> CameraAnswer:
    """Import a camera that another program calibrated.

    Parameters
    ----------
    file : Path
        Calib_Results.m or .mat, OpenCV storage, Kalibr camchain or ROS camera_info.
    format : str
        Format: auto, matlab, opencv, kalibr or ros.
    size : str, optional
        Size of your pictures, such as 1280x720; a file for another size is rejected.
    which : str
        Camera to read from a Kalibr file with several cameras, such as cam0.
    unit : str
        Unit of lengths in a MATLAB file: mm, cm or m.
    """
    from fixel.workflows.acquisition.camera import work

    return work.imported(CAMERA["import"].asked(locals()))


def export_camera(
    camera: CameraFile,
    *,
    out: Annotated[Path, Door(meaning="File to write.")],
    format: str = "opencv",
    progress: ProgressOption = None,
) -> CameraAnswer:
    """Write a lens as an OpenCV or ROS file.

    Parameters
    ----------
    format : str
        Format: opencv or ros.
    """
    from fixel.workflows.acquisition.camera import work

    return work.exported(CAMERA["export"].asked(locals()))


def place_camera(
    camera: CameraFile,
    picture: Annotated[Path, Door(metavar="PICTURE")],
    *,
    board: Annotated[str | None, BOARD] = None,
    at: Annotated[str, Door(metavar="X,Y,ANGLE")] = "0,0,0",
    thickness: Annotated[float, Door(unit="mm", least=0.0)] = 0.0,
    rig: Annotated[str | None, Door(metavar="RIG")] = None,
    out: Annotated[Path | None, Door(usual="CAMERA-placed")] = None,
    height: Height = THESIS_HEIGHTS,
    plot: Plot = None,
    progress: ProgressOption = None,
) -> CameraAnswer:
    """Compute the pose of a camera above the plate.

    It also reports the accuracy of positions on the plate. Tags of a rig on the plate are used if
    two or more of them are seen, otherwise the board.

    Parameters
    ----------
    picture : Path
        Picture of the plate, or a video, of which the first frame is used.
    at : str
        Pose of the board's lower left corner in the world: x, y [mm], angle [deg].
    thickness : float
        Thickness of the board [m].
    rig : str, optional
        Rig whose tags are on the plate; by default rig.yaml next to the camera file or the picture.
    out : Path, optional
        Camera file to write.
    """
    from fixel.workflows.acquisition.camera import work

    return work.placed(CAMERA["place"].asked(locals()))


def check_camera(
    camera: Annotated[str, Door(metavar="CAMERA")],
    *,
    video: Path | None = None,
    height: Height = THESIS_HEIGHTS,
    plot: Plot = None,
    progress: ProgressOption = None,
) -> CameraAnswer:
    """Report whether a camera has moved, and its accuracy.

    Parameters
    ----------
    camera : str
        Camera file, rig file, or name of an example rig.
    video : Path, optional
        Video or picture of the bench, to check its size and the pose of the camera.
    """
    from fixel.workflows.acquisition.camera import work

    return work.checked(CAMERA["check"].asked(locals()))


def print_board(
    board: Annotated[str, Door(metavar="BOARD")] = USUAL_BOARD,
    *,
    out: Printed = Path("board.pdf"),
    paper: Paper = "a4",
    progress: ProgressOption = None,
) -> PrintAnswer:
    """Write a calibration board to print, true to scale.

    Parameters
    ----------
    board : str
        Board, as for fixel camera calibrate.
    """
    from fixel.workflows.acquisition.camera import work

    return work.printed_board(CAMERA["board"].asked(locals()))


def print_tags(
    rig: Annotated[str | None, Door(metavar="RIG")] = None,
    *,
    ids: Annotated[str | None, Door(metavar="FIRST-LAST")] = None,
    size: Annotated[float, Door(unit="mm")] = 0.03,
    family: str = "apriltag-36h11",
    out: Printed = Path("tags.pdf"),
    paper: Paper = "a4",
    progress: ProgressOption = None,
) -> PrintAnswer:
    """Write tags to print, true to scale.

    Write all tags of a rig, or a range of numbers.

    Parameters
    ----------
    rig : str, optional
        Rig whose tags are printed.
    ids : str, optional
        Range of tag numbers, instead of a rig: 0-9.
    size : float
        Side of the black square [m].
    family : str
        Tag family: apriltag-36h11, aruco-4x4-50 or aruco-5x5-100.
    """
    from fixel.workflows.acquisition.camera import work

    return work.printed_tags(CAMERA["tags"].asked(locals()))


CAMERA: Final[Mapping[str, Capability]] = {
    verb: Capability(name=f"camera-{verb}", function=own, plot="", group="camera", verb=verb)
    for verb, own in (
        ("calibrate", calibrate_camera),
        ("import", import_camera),
        ("export", export_camera),
        ("place", place_camera),
        ("check", check_camera),
        ("board", print_board),
        ("tags", print_tags),
    )
}
