"""Simulate the pushes of `fixel.datasets.example`, and print their table.

Run: python tools/example_pushes.py | gzip --no-name > src/fixel/datasets/example.csv.gz
"""

from __future__ import annotations

import csv
import sys

import numpy as np

import fixel
from fixel.testing.scenes import row

LENGTH, WIDTH, TIP = 0.100, 0.080, 0.005  # [m]
RATE, DURATION, SPEED, REST = 20.0, 3.0, 0.020, 0.2  # [Hz], [s], [m/s], [s]
FRICTION, SPREAD = 0.22, 0.05  # of the tip, and the spread of its logarithm
RADIUS = 0.038  # of the tripod [m]
TABLE = {"abs": 0.15, "plywood": 0.35}  # friction of the table
HEAD = "push,surface,contact_offset_mm,push_angle_deg,time_s,x_mm,y_mm,theta_deg,tip_x_mm,tip_y_mm"


def main() -> None:
    """Print the table."""
    rng = np.random.default_rng(11)
    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow(HEAD.split(","))
    time = np.arange(0.0, DURATION + 1e-9, 1.0 / RATE)
    for number in range(40):
        surface = [*TABLE][number % 2]
        offset = float(np.round(rng.uniform(-30.0, 30.0))) / 1e3
        angle = np.radians(float(np.round(rng.uniform(-25.0, 25.0))))
        x, y = rng.uniform(0.15, 0.25), rng.uniform(-0.05, 0.05)
        theta = rng.uniform(-np.pi, np.pi)
        friction = FRICTION * np.exp(rng.normal(0.0, SPREAD))
        turn = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
        begin = row(-LENGTH / 2 - TIP - 0.001, offset)
        way = np.clip(time - REST, 0.0, None)[:, None] * SPEED * row(np.cos(angle), np.sin(angle))
        tip = row(x, y) + (begin + way) @ turn.T
        path = np.column_stack((time, tip, np.zeros(len(time))))
        part = fixel.Body(
            "part",
            fixel.Polygon.rectangle(LENGTH, WIDTH),
            mass=0.5,
            pose=row(x, y, theta),
            support=fixel.Tripod(radius=RADIUS, friction=TABLE[surface]),
        )
        pusher = fixel.Pusher(
            "tip",
            fixel.Disk(TIP),
            drive=fixel.PathDrive(waypoints=path),
            friction=friction,
        )
        scene = fixel.Scene((part,), (pusher,), duration=DURATION)
        run = fixel.simulate(scene, output_interval=1.0 / RATE)
        pose = np.column_stack([np.interp(time, run.time, own) for own in run.pose["part"].T])
        pose = pose + rng.normal(size=pose.shape) * [2e-4, 2e-4, np.radians(0.15)]
        tip = tip + rng.normal(size=tip.shape) * 3e-5
        named = (f"{number:02d}", surface, f"{1e3 * offset:g}", f"{np.degrees(angle):.0f}")
        for t, own, other in zip(time, pose, tip, strict=True):
            places = (1e3 * own[0], 1e3 * own[1], np.degrees(own[2]), *(1e3 * other))
            writer.writerow((*named, f"{t:.2f}", *(f"{value:.2f}" for value in places)))


if __name__ == "__main__":
    main()
