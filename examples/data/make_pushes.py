"""Write pushes.csv: eight pushes of a box with known friction, as a camera would measure them.

The true values are mu_pusher = 0.22 and tripod_radius = 41 mm. The measured positions have a noise
of 0.2 mm, the angles of 0.18 degrees. Run: python examples/data/make_pushes.py
"""

import math
from pathlib import Path

import numpy as np

import fixel

CORNERS = [(-0.045, -0.0565), (0.045, -0.0565), (0.045, 0.0565), (-0.045, 0.0565)]
RADIUS = 0.00475  # of the tip [m]
SPEED, DURATION, RATE = 0.020, 3.0, 20  # [m/s], [s], [frames/s]


def main() -> None:
    rng = np.random.default_rng(8)
    rows = ["push,time_s,x_mm,y_mm,theta_deg,pusher_x_mm,pusher_y_mm"]
    for push in range(8):
        offset, angle = rng.uniform(-0.035, 0.035), rng.uniform(-0.45, 0.45)
        pose = (*rng.uniform(-0.02, 0.02, 2), rng.uniform(-math.pi, math.pi))
        start, direction = tip_start(pose, offset), turned((1.0, 0.0), pose[2] + angle)
        scene = fixel.Scene(
            bodies=[
                fixel.Body(
                    name="box",
                    shape=fixel.Polygon(CORNERS),
                    mass=0.8,
                    pose=pose,
                    support=fixel.Tripod(radius=0.041, friction=0.25),
                )
            ],
            pushers=[
                fixel.Pusher(
                    name="tip",
                    shape=fixel.Disk(RADIUS),
                    pose=(*start, 0.0),
                    drive=fixel.LineDrive(direction=direction, speed=SPEED),
                    friction=0.22,
                )
            ],
            duration=DURATION,
        )
        run = fixel.simulate(scene, motion=fixel.QuasiStatic(), output_interval=1 / RATE)
        noise = rng.normal(size=(len(run.time), 3)) * (2e-4, 2e-4, math.radians(0.18))
        for time, measured in zip(run.time, run.pose["box"] + noise, strict=True):
            tip = np.add(start, SPEED * time * np.asarray(direction))
            values = (*1e3 * measured[:2], math.degrees(measured[2]), *1e3 * tip)
            rows.append(f"{push},{time:.3f}," + ",".join(f"{value:.3f}" for value in values))
    path = Path(__file__).with_name("pushes.csv")
    path.write_text("\n".join([*rows, ""]), encoding="utf-8")


def tip_start(pose: tuple[float, ...], offset: float) -> np.ndarray:
    """Return where the tip touches the left side of the box, at an offset along it."""
    return np.add(pose[:2], turned((-0.045 - RADIUS - 5e-4, offset), pose[2]))


def turned(vector: tuple[float, float], angle: float) -> np.ndarray:
    """Return a vector turned by an angle."""
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([[cos, -sin], [sin, cos]]) @ vector


if __name__ == "__main__":
    main()
