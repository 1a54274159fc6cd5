"""Speed and accuracy of fixel against its targets and its peers: python -m benchmarks."""

import os

# One thread unless a benchmark says otherwise; read when NumPy loads, hence here.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
