"""Pushes of a square in closed form, by an ellipsoidal limit surface: no code of fixel's.

Source: Lynch, Maekawa, Tanie, Manipulation and active sensing by pushing using tactile feedback,
IROS 1992, for a tip that sticks; at the edges of the friction cone the tip slides.
"""

import math

import numpy as np

SIDE, TIP = 0.09, 0.005  # [m]
LEVER = 0.3826 * SIDE  # torque over force of an evenly loaded square [m]


def push(mu, offset, *, speed=0.02, duration=2.0, rate=50.0, angle=0.0):
    """Times (n,), poses of the square (n, 3) and centres of the tip (n, 2).

    The tip touches the face at -x, `offset` from its middle, and moves along the world's x.
    """
    pose = np.array([0.0, 0.0, angle])
    tip = _world(pose, (-SIDE / 2 - TIP, offset))
    fine, n = 10, round(duration * rate)
    step = 1.0 / (rate * fine)
    poses, tips = [pose], [tip]
    way = np.array([speed, 0.0])
    for _ in range(n):
        for _ in range(fine):
            middle = pose + 0.5 * step * _twist(pose, tip, way, mu)
            pose = pose + step * _twist(middle, tip + 0.5 * step * way, way, mu)
            tip = tip + step * way
        poses.append(pose)
        tips.append(tip)
    return np.arange(n + 1) / rate, np.array(poses), np.array(tips)


def _twist(pose, tip, way, mu):
    turn = np.array(
        [[math.cos(pose[2]), -math.sin(pose[2])], [math.sin(pose[2]), math.cos(pose[2])]]
    )
    contact = turn.T @ (tip - pose[:2]) + (TIP, 0.0)
    wanted = turn.T @ way
    # Velocity of the point of contact under a unit force along each axis.
    x, y = contact
    moved = np.array([[1 + y * y / LEVER**2, -x * y / LEVER**2],
                      [-x * y / LEVER**2, 1 + x * x / LEVER**2]])  # fmt: skip
    force = np.linalg.solve(moved, wanted)
    if abs(force[1]) > mu * force[0]:
        edge = np.array([1.0, math.copysign(mu, force[1])])
        force = edge * wanted[0] / (moved @ edge)[0]
    spin = (x * force[1] - y * force[0]) / LEVER**2
    return np.array([*(turn @ force), spin])


def _world(pose, point):
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return pose[:2] + np.array([c * point[0] - s * point[1], s * point[0] + c * point[1]])


def table_text(time, pose, tip, header="time_s,x_mm,y_mm,theta_deg,tip_x_mm,tip_y_mm"):
    """A table of a push; columns are scaled as the header of the default says."""
    rows = np.column_stack((time, 1e3 * pose[:, :2], np.degrees(pose[:, 2]), 1e3 * tip))
    return header + "\n" + "".join(",".join(f"{v:.9g}" for v in row) + "\n" for row in rows)
