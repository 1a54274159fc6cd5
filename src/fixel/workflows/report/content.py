"""Content of a report as plain data, without markup."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from fixel.table import Table


class Figure(NamedTuple):
    """Picture with its files."""

    name: str  # name of its files, unique in the report
    caption: str
    png: Path  # its PDF and CSV are in the same folder


class Section(NamedTuple):
    """Part of a report under a heading."""

    title: str
    anchor: str  # for links within the page
    lead: tuple[str, ...] = ()  # sentences before tables and figures
    tables: tuple[Table, ...] = ()
    figures: tuple[Figure, ...] = ()
    notes: tuple[str, ...] = ()  # sentences after tables and figures, in small print
    commands: tuple[str, ...] = ()  # that repeat its analyses


class Content(NamedTuple):
    """Content of a whole report."""

    title: str
    banner: str  # for data that no camera has seen; empty if all of it is real
    facts: tuple[tuple[str, str], ...]  # provenance: name and value
    warnings: tuple[str, ...]  # in plain words, the gravest first
    findings: tuple[str, ...]  # main results in a few sentences
    sections: tuple[Section, ...]
    methods: tuple[str, ...]  # sentences of the methods section
    references: tuple[str, ...] = ()  # keys of the bibliography, in the order they are needed
    commands: tuple[str, ...] = ()  # that repeat everything, in order
