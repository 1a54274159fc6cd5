"""What a report says, before it is written: plain content, no markup."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import final

from fixel.workflows.analysis import TextTable


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """A picture with its files.

    Attributes
    ----------
    name : str
        Of its files, unique in the report.
    caption : str
    png : Path
        Its PDF and CSV lie beside it.
    """

    name: str
    caption: str
    png: Path


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A part of the report under a heading.

    Attributes
    ----------
    title : str
    anchor : str
        For links within the page.
    lead : tuple of str
        Sentences before tables and figures.
    tables : tuple of TextTable
    figures : tuple of Figure
    notes : tuple of str
        Sentences after them, in small print.
    commands : tuple of str
        That make it again.
    """

    title: str
    anchor: str
    lead: tuple[str, ...] = ()
    tables: tuple[TextTable, ...] = ()
    figures: tuple[Figure, ...] = ()
    notes: tuple[str, ...] = ()
    commands: tuple[str, ...] = ()


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Content:
    """A whole report.

    Attributes
    ----------
    title : str
    banner : str
        For data that no camera has seen; empty where all of it is real.
    facts : tuple of (str, str)
        Provenance: name and value.
    warnings : tuple of str
        In plain words, the gravest first.
    findings : tuple of str
        The answer in a few sentences.
    sections : tuple of Section
    methods : tuple of str
        Sentences of the methods paragraph.
    references : tuple of str
        Keys of the bibliography, in the order they are first needed.
    commands : tuple of str
        That make everything again, in order.
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
