"""Work that takes long: in this process, in several, or on a cluster; interrupted and continued.

A piece of work is a generator that yields rounds of chunks and is sent their answers
(`work.py`). An engine answers chunks (`engine.py`, `dask_engine.py`); a journal keeps every answer;
the coordinator (`coordinator.py`) is the one process that writes it.
"""
