"""Tiny recordings in the formats of the real ones, with numbers of our own."""

import json
import math

from tests.datasets import push_files
from tests.datasets.push_files import write_table


def rpi_2dgad(folder):
    """Trial 7 is complete; of 8 (object 17, no valid mode) and 9 only the object is kept."""
    push_files.rpi_2dgad(folder)
    common = {"start_frame": 2, "end_frame": 30}
    write_table(
        folder / "experiments.csv",
        [
            {"experiment_id": 7, "object_id": 12, "final_contact_mode_experiment": 2} | common,
            {"experiment_id": 8, "object_id": 17, "final_contact_mode_experiment": 8} | common,
            {"experiment_id": 9, "object_id": 12, "final_contact_mode_experiment": 4} | common,
        ],
    )
    write_table(
        folder / "object_trajectory.csv.gz",
        [
            {"experiment_id": number, "frame": k + 1, "x_mm": 10.0, "y_mm": 200.0 - k,
             "z_mm": 45.0, "theta_rad": math.pi - 0.02 + 0.01 * k - 2 * math.pi * (k > 2)}
            for number in (7, 8, 9)
            for k in range(31)
        ],
    )  # fmt: skip
    return folder


def mit_pusher_slider(folder, **changes):
    """A second of pushing with what the controller wanted, and gaps."""
    more = {"pusher_cmd_x": 0.0, "pusher_cmd_y": 0.0, "u0": 0.1, "u1": -0.1, "gap_mm": 0.0}
    return push_files.mit_timeseries(folder, **(more | changes))


def record(**changes):
    """A push of the published data set: 50 readings at 250 Hz, on a clock since 1970."""
    begin = 1460088637.0
    times = [begin + 0.004 * k for k in range(50)]
    return {
        "object_pose": [[t, 0.3 + 0.1 * (t - begin), 0.0, 0.0] for t in times],
        "tip_pose": [[t, 0.2 + 0.1 * (t - begin), 0.0, 0.0] for t in times],
        "ft_wrench": [[t, 1.0, 0.0, 0.01] for t in times],
    } | changes  # fmt: skip


RECORD = "motion_surface=felt_shape=rect1_a=0_v=100_i=1.000_s=0.500_t=-0.349"


def mit_records(folder):
    """A published file as JSON, in a folder below the outlines."""
    push_files.mit_timeseries(folder)
    (folder / "cpush_Straight.csv.gz").unlink()
    (folder / "felt").mkdir(exist_ok=True)
    (folder / "felt" / f"{RECORD}.json").write_text(json.dumps(record()))
    return folder


def cmu_tripod(folder, **changes):
    """Two pushes of a triangle, one on three points and one on its face."""
    folder.mkdir(exist_ok=True)
    points = [[-0.02, -0.02], [0.04, -0.02], [-0.02, 0.04]]
    setup = {
        "object": {"vertices_m": [[-0.05, -0.05], [0.1, -0.05], [-0.05, 0.1]], "mass_kg": 1.5},
        "support_points_m": {"points": points, "patch": None},
        "author_friction_coefficient": {"felt": 0.3},
        "pusher": {"radius_m_assumed_by_authors": 0.001},
    }
    (folder / "setup.json").write_text(json.dumps(setup))
    pushes = [
        {"push_id": f"push_{k}", "surface": "felt", "support": support, "source_log": "log_mixed",
         "obj_x0": 0.5, "obj_y0": 0.0, "obj_th0": 0.0, "obj_x1": 0.51, "obj_y1": 0.0,
         "obj_th1": 0.1, "tip_gap0_mm": 2.0, "tip_gap1_mm": 0.5 + k} | changes
        for k, support in enumerate(("points", "patch"))
    ]  # fmt: skip
    write_table(folder / "pushes.csv", pushes)
    write_table(
        folder / "force.csv.gz",
        [
            {"push_id": push["push_id"], "t": 0.01 * k, "fx_sensor_raw": 0.0,
             "fy_sensor_raw": 0.0, "fx_on_object": 4.0, "fy_on_object": -0.5}
            for push in pushes
            for k in range(60)
        ],
    )  # fmt: skip
    write_table(
        folder / "robot.csv.gz",
        [
            {"push_id": push["push_id"], "t": 0.0001 + 0.03 * k, "x_mm": 447.0 + 0.6 * k,
             "y_mm": 0.0, "z_mm": 20.0, "qw": math.cos(0.1), "qx": 0.0, "qy": 0.0,
             "qz": math.sin(0.1)}
            for push in pushes
            for k in range(20)
        ],
    )  # fmt: skip
    return folder


def cmu_two_point(folder):
    """Two runs of 40 readings, the last five of each without the object."""
    folder.mkdir(exist_ok=True)
    runs = [
        {"run_id": f"{kind}_0", "object": kind, "start_pose": f"{kind}_a", "n": 40}
        for kind in ("brick_3pts", "brick_ridge")
    ]
    write_table(folder / "runs.csv", runs)
    write_table(
        folder / "poses.csv.gz",
        [
            {"run_id": run["run_id"], "t": round(0.03 * k, 2),
             "obj_x_mm": 10.0 + k if k < 35 else 0, "obj_y_mm": -300.0 if k < 35 else 0,
             "obj_th": 1.5 if k < 35 else 0, "pusher_x_mm": 40.0, "pusher_y_mm": -347.0,
             "pusher_th": math.pi * (-1) ** k, "action_id": 1 + k // 20,
             "obj_lost": int(k >= 35)}
            for run in runs
            for k in range(40)
        ],
    )  # fmt: skip
    return folder


def table_file(path, text):
    path.write_text(text, encoding="utf-8")
    return path
