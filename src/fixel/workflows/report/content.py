"""Content of a report as plain data, without markup."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import final

from fixel.table import Table


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """Picture with its files.

    Attributes
    ----------
    name : str
        Name of its files, unique in the report.
    caption : str
    png : Path
        PNG file; its PDF and CSV are in the same folder.
    """

    name: str
    caption: str
    png: Path


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """Part of a report under a heading.

    Attributes
    ----------
    title : str
    anchor : str
        Anchor for links within the page.
    lead : tuple of str
        Sentences before tables and figures.
    tables : tuple of Table
    figures : tuple of Figure
    notes : tuple of str
        Sentences after tables and figures, in small print.
    commands : tuple of str
        Commands that repeat its analyses.
    """

    title: str
    anchor: str
    lead: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    figures: tuple[Figure, ...] = ()
    notes: tuple[str, ...] = ()
    commands: tuple[str, ...] = ()


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Content:
    """Content of a whole report.

    Attributes
    ----------
    title : str
    banner : str
        Text for data that no camera has seen; empty if all of it is real.
    facts : tuple of (str, str)
        Provenance: name and value.
    warnings : tuple of str
        Warnings in plain words, the gravest first.
    findings : tuple of str
        Main results in a few sentences.
    sections : tuple of Section
    methods : tuple of str
        Sentences of the methods section.
    references : tuple of str
        Keys of the bibliography, in the order they are first needed.
    commands : tuple of str
        Commands that repeat everything, in order.
    """

    title: str
    banner: str
    facts: tuple[tuple[str, str], ...]
    warnings: tuple[str, ...]
    findings: tuple[str, ...]
    sections: tuple[Section, ...]
    methods: tuple[str, ...]
    references: tuple[str, ...] = ()
    commands: tuple[str, ...] = field(default=())
