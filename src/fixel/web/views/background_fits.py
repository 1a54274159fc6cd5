"""Fits that take minutes: in processes of their own, shared by clients, stopped when unused."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Any, Final, Generic, TypeVar, final

from fixel.errors import JobRefused
from fixel.jobs.worker_process import CallCancellation, WorkerProcess

K = TypeVar("K", bound=Hashable)
A = TypeVar("A")

MAX_FITS: Final = 3  # fits at a time
LIMIT: Final = 3600.0  # [s]
FORGOTTEN: Final = 120.0  # [s] without a request that stop a fit; browsers suspend hidden pages
ENDS_WITHIN: Final = 2.0  # [s]


@final
@dataclass
class BackgroundFit:
    """Fit that is running or has failed.

    Attributes
    ----------
    ended : Event
        Set when the fit has ended, with an answer or without.
    """

    ended: threading.Event = field(default_factory=threading.Event)
    _begun: float = field(default_factory=time.monotonic)
    _asked: float = field(default_factory=time.monotonic)
    _stopped: threading.Event = field(default_factory=threading.Event)
    _problem: Exception | None = None

    @property
    def seconds(self) -> float:
        """Time since the fit began."""
        return time.monotonic() - self._begun

    def _nobody_waits(self) -> bool:
        return self._stopped.is_set() or time.monotonic() - self._asked > FORGOTTEN


@final
class Fits(Generic[K, A]):
    """Fits by a key, each a call of a function in a process of its own.

    Parameters
    ----------
    function : callable
        Function of a module, of one argument. Argument and answer can be pickled.
    """

    def __init__(self, function: Callable[[Any], A]) -> None:
        self._function = function
        self._fits: dict[K, BackgroundFit] = {}
        self._lock = threading.Lock()

    def joined(self, key: K) -> BackgroundFit | None:
        """Return the running fit of a key and note the request; raise the error of a failed fit."""
        with self._lock:
            fit = self._fits.get(key)
            if fit is None:
                return None
            if fit._problem is not None:
                self._fits.pop(key)
                raise fit._problem
            fit._asked = time.monotonic()
            return fit

    def begun(self, key: K, argument: Any, put: Callable[[A], object]) -> BackgroundFit:
        """Begin a fit, unless one is running for the key; `put` is called with the answer.

        Raises
        ------
        JobRefused
            Too many fits are running.
        """
        with self._lock:
            fit = self._fits.get(key)
            if fit is not None:
                return fit
            if sum(not one.ended.is_set() for one in self._fits.values()) >= MAX_FITS:
                raise JobRefused(
                    f"{MAX_FITS} maps are being fitted to other axes",
                    hint="wait until one has finished, or stop one",
                )
            fit = self._fits[key] = BackgroundFit()
        threading.Thread(target=self._run, args=(key, fit, argument, put), daemon=True).start()
        return fit

    def stop(self, key: K) -> None:
        """Stop the fit of a key, if there is one."""
        with self._lock:
            fit = self._fits.get(key)
        if fit is not None:
            fit._stopped.set()
            fit.ended.wait(ENDS_WITHIN)

    def _run(self, key: K, fit: BackgroundFit, argument: Any, put: Callable[[A], object]) -> None:
        try:
            with WorkerProcess(self._function, limit=LIMIT, hint="choose fewer cells") as beside:
                put(beside.call(argument, fit._nobody_waits))
        except CallCancellation:
            pass
        except Exception as problem:  # raised at the next request
            fit._problem = problem
        finally:
            with self._lock:
                if fit._problem is None:
                    self._fits.pop(key)
            fit.ended.set()
