"""
A campaign on a SLURM cluster
=============================

The same call runs here, in several processes, or on a cluster. A site file describes the cluster:

.. literalinclude:: ../../examples/sites/department.yaml
   :language: yaml

On the cluster: ``fixel.calibrate_campaign(..., site="department.yaml", workers=16, store="fit")``,
or ``fixel calibrate --mode campaign --site department.yaml --workers 16``. Here it runs in this
process. The store is a folder with a journal: interrupted, the same call continues.
"""

import tempfile

import fixel
from fixel.units import mm

pushes = fixel.read_experiments("../data/pushes.csv", split_by="push", scene="../data/bench.yaml")
campaign = fixel.calibrate_campaign(
    pushes[:4],
    {"mu_pusher": (0, 1), "tripod_radius": (10 * mm, 60 * mm)},
    motion="quasistatic",
    verdicts=False,
    store=f"{tempfile.mkdtemp()}/fit",
)
campaign
