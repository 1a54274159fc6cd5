"""Tiny datasets in the formats of the real ones, with numbers of our own."""

import csv
import gzip
import json
import math

SQUARE = [[0.03, 0.03], [-0.03, 0.03], [-0.03, -0.03], [0.03, -0.03]]
TIP = 0.00475


def write_table(path, rows):
    opened = gzip.open if path.suffix == ".gz" else open
    with opened(path, "wt", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def push(number, **changes):
    """A push through the middle of a side: the object goes straight on for 50 mm."""
    touch = 0.03 + TIP
    return {
        "push_id": f"felt_block_{number}", "surface": "felt", "shape": "block", "speed_mm_s": 10,
        "obj_x0": 0.2, "obj_y0": -0.1, "obj_th0": 0.0,
        "obj_x1": 0.25, "obj_y1": -0.1, "obj_th1": 0.0,
        "tip_x0": 0.2 - touch, "tip_y0": -0.1, "tip_x1": 0.25 - touch, "tip_y1": -0.1,
        "gap0_mm": 0.0, "gap1_mm": 0.0,
        "author_poly4_x1": 0.252, "author_poly4_y1": -0.1, "author_poly4_th1": math.pi / 180,
        "author_quad_x1": "", "author_quad_y1": "", "author_quad_th1": "",
    } | changes  # fmt: skip


def mit_push(folder, *pushes):
    folder.mkdir(exist_ok=True)
    write_table(folder / "pushes.csv.gz", list(pushes))
    shapes = {
        "block": {"type": "polygon", "vertices_m": SQUARE},
        "coin": {"type": "ellipse", "semi_axis_x_m": 0.03, "semi_axis_y_m": 0.03},
        "egg": {"type": "ellipse", "semi_axis_x_m": 0.03, "semi_axis_y_m": 0.04},
    }
    (folder / "shapes.json").write_text(json.dumps(shapes))
    return folder


def rpi_2dgad(folder, frames=31):
    """Trial 7: a square pushed down at 9 mm/s, from 2 mm away."""
    folder.mkdir(exist_ok=True)
    setup = {
        "system_parameters_calibrated_by_authors": {
            "tripod_radius_mm": 20.0, "mu_actuator": 0.3, "mu_support": 0.4, "mu_fixel": 0.2,
        },
        "start_frame": 2, "end_frame": frames - 1, "final_contact_mode": 2,
        "fixel_radius_mm": 5.0, "fixel_positions_mm": [[0, -90], [-60, -90], [60, -90]],
        "object": {
            "vertices_mm": [[-30, 30], [30, 30], [30, -30], [-30, -30]],
            "mass_kg": 0.2, "moment_of_inertia_kg_mm2": 120.0,
        },
        "actuator": {
            "vertices_mm": [[-10, 10], [10, 10], [10, -10], [-10, -10]], "orientation_rad": 0.0,
        },
    }  # fmt: skip
    (folder / "exp7_setup.json").write_text(json.dumps(setup))
    rows = [
        {
            "frame": k + 1, "time_s": (k + 1) / 30,
            "object_x_mm": 0.0, "object_y_mm": -max(0.0, 0.3 * k - 2.0), "object_theta_rad": 0.0,
            "actuator_x_mm": 0.0, "actuator_y_mm": 42.0 - 0.3 * k,
            "actuator_marker_x_mm": 0.0, "actuator_marker_y_mm": 42.0 - 0.3 * k,
            "tactile_1": 0, "tactile_2": int(k > 20), "tactile_3": 0,
        }
        for k in range(frames)
    ]  # fmt: skip
    write_table(folder / "exp7_frames.csv", rows)
    names = ("frame", "object_x_mm", "object_y_mm", "object_theta_rad", "actuator_x_mm")
    stored = [{name: row[name] for name in (*names, "actuator_y_mm")} for row in rows[1:]]
    write_table(folder / "exp7_author_simulation.csv", stored)
    return folder


def mit_timeseries(folder, **columns):
    """One second of pushing a square straight on at 20 mm/s, read twice per new value."""
    folder.mkdir(exist_ok=True)
    square = [[0.045, 0.045], [-0.045, 0.045], [-0.045, -0.045], [0.045, -0.045]]
    (folder / "shapes.json").write_text(json.dumps({"rect1": square, "pusher_radius_m": TIP}))
    rows = []
    for k in range(400):
        x = 0.02 * 0.005 * (k // 2)
        tip = x - 0.045 - TIP
        rows.append(
            {"t": 1 + 0.0025 * k, "slider_x": x, "slider_y": 0.0, "slider_th": 0.0,
             "pusher_x": tip, "pusher_y": 0.0} | columns
        )  # fmt: skip
    write_table(folder / "cpush_Straight.csv.gz", rows)
    return folder
