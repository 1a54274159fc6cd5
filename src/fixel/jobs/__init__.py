"""Long computations, in one process, in several or on a cluster, that can be resumed.

A piece of work is a generator that yields rounds of chunks and is sent their answers
(`work.py`). An engine answers chunks (`work.py`, `dask_engine.py`). A journal stores every
answer; only the coordinator (`coordinator.py`) writes it.
"""
