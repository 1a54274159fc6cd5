"""
From a camera to an experiment
==============================

A recording of a camera becomes an experiment with a scene. Here the recording is rendered from a
simulation, so the true motion is known.
"""

import tempfile
from pathlib import Path

import fixel
from fixel.workflows.acquisition.film import FilmSettings, film

folder = Path(tempfile.mkdtemp())
film(["../scenes/grasp.yaml"], folder / "push", FilmSettings(rate=10, frames=60))
experiments = fixel.read_experiments(folder / "push")  # finds the tags in every frame
experiments

# %%
experiments[0].plot()
