"""Drake with its former solver, which its releases announce to remove."""

from __future__ import annotations

from typing import Any

from benchmarks.peers import drake

name = "Drake TAMSI"
version = drake.version
variants: dict[str, dict[str, Any]] = {"as shipped": {"approximation": "tamsi"}}
build = drake.build
run = drake.run
