"""What a report may cite, as BibTeX."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version
from typing import Final, NamedTuple


class Work(NamedTuple):
    """A work that can be cited."""

    kind: str  # of the BibTeX entry
    author: str
    title: str
    year: str
    where: tuple[tuple[str, str], ...] = ()  # further fields


WORKS: Final = {
    # From copies of the title pages: vdocuments.net (exploring-the-domain-of-applicability-of-
    # simulated) and moam.info (detc2006-99687). The texts that fixel follows have no title page:
    # they confirm ASME and 2006, and that the thesis was finished after 11 November 2011, no more.
    # Calibrations store the keys, so these remain although the thesis is of 2012.
    "rpi2011": Work(
        "mastersthesis",
        "Macaluso, W.",
        "Exploring the domain of applicability of simulated 2D rigid body dynamical systems",
        "2012",
        (("school", "Rensselaer Polytechnic Institute, Troy, New York"),),
    ),
    "asme2006": Work(
        "inproceedings",
        "Cappelleri, D. J. and Fink, J. and others",
        "Modeling uncertainty for planar meso-scale manipulation and assembly",
        "2006",
        (
            (
                "booktitle",
                "ASME International Design Engineering Technical Conferences and Computers and"
                " Information in Engineering Conference (IDETC/CIE)",
            ),
            ("note", "DETC2006-99687"),
        ),
    ),
    "stewart1996": Work(
        "article",
        "Stewart, D. E. and Trinkle, J. C.",
        "An implicit time-stepping scheme for rigid body dynamics with inelastic collisions and"
        " Coulomb friction",
        "1996",
        (
            ("journal", "International Journal for Numerical Methods in Engineering"),
            ("volume", "39"),
            ("pages", "2673--2691"),
        ),
    ),
    "goyal1991": Work(
        "article",
        "Goyal, S. and Ruina, A. and Papadopoulos, J.",
        "Planar sliding with dry friction. Part 1. Limit surface and moment function",
        "1991",
        (("journal", "Wear"), ("volume", "143"), ("pages", "307--330")),
    ),
    "yu2016": Work(
        "inproceedings",
        "Yu, K.-T. and Bauza, M. and Fazeli, N. and Rodriguez, A.",
        "More than a million ways to be pushed. A high-fidelity experimental dataset of planar"
        " pushing",
        "2016",
        (
            (
                "booktitle",
                "IEEE/RSJ International Conference on Intelligent Robots and Systems (IROS)",
            ),
        ),
    ),
    "torczon1997": Work(
        "article",
        "Torczon, V.",
        "On the convergence of pattern search algorithms",
        "1997",
        (("journal", "SIAM Journal on Optimization"), ("volume", "7"), ("pages", "1--25")),
    ),
    "nelder1965": Work(
        "article",
        "Nelder, J. A. and Mead, R.",
        "A simplex method for function minimization",
        "1965",
        (("journal", "The Computer Journal"), ("volume", "7"), ("pages", "308--313")),
    ),
    "raue2009": Work(
        "article",
        "Raue, A. and Kreutz, C. and Maiwald, T. and Bachmann, J. and Schilling, M. and"
        ' Klingm{\\"u}ller, U. and Timmer, J.',
        "Structural and practical identifiability analysis of partially observed dynamical models"
        " by exploiting the profile likelihood",
        "2009",
        (("journal", "Bioinformatics"), ("volume", "25"), ("pages", "1923--1929")),
    ),
    "vovk2005": Work(
        "book",
        "Vovk, V. and Gammerman, A. and Shafer, G.",
        "Algorithmic learning in a random world",
        "2005",
        (("publisher", "Springer"),),
    ),
    "barber2021": Work(
        "article",
        "Barber, R. F. and Cand{\\`e}s, E. J. and Ramdas, A. and Tibshirani, R. J.",
        "Predictive inference with the jackknife+",
        "2021",
        (("journal", "The Annals of Statistics"), ("volume", "49"), ("pages", "486--507")),
    ),
    "lei2018": Work(
        "article",
        "Lei, J. and G'Sell, M. and Rinaldo, A. and Tibshirani, R. J. and Wasserman, L.",
        "Distribution-free predictive inference for regression",
        "2018",
        (
            ("journal", "Journal of the American Statistical Association"),
            ("volume", "113"),
            ("pages", "1094--1111"),
        ),
    ),
    "speagle2020": Work(
        "article",
        "Speagle, J. S.",
        "dynesty: a dynamic nested sampling package for estimating Bayesian posteriors and"
        " evidences",
        "2020",
        (
            ("journal", "Monthly Notices of the Royal Astronomical Society"),
            ("volume", "493"),
            ("pages", "3132--3158"),
        ),
    ),
    "skilling2006": Work(
        "article",
        "Skilling, J.",
        "Nested sampling for general Bayesian computation",
        "2006",
        (("journal", "Bayesian Analysis"), ("volume", "1"), ("pages", "833--859")),
    ),
    "feroz2009": Work(
        "article",
        "Feroz, F. and Hobson, M. P. and Bridges, M.",
        "MultiNest: an efficient and robust Bayesian inference tool for cosmology and particle"
        " physics",
        "2009",
        (
            ("journal", "Monthly Notices of the Royal Astronomical Society"),
            ("volume", "398"),
            ("pages", "1601--1614"),
        ),
    ),
    "kennedy2001": Work(
        "article",
        "Kennedy, M. C. and O'Hagan, A.",
        "Bayesian calibration of computer models",
        "2001",
        (
            ("journal", "Journal of the Royal Statistical Society B"),
            ("volume", "63"),
            ("pages", "425--464"),
        ),
    ),
    "talts2018": Work(
        "misc",
        "Talts, S. and Betancourt, M. and Simpson, D. and Vehtari, A. and Gelman, A.",
        "Validating Bayesian inference algorithms with simulation-based calibration",
        "2018",
        (("note", "arXiv:1804.06788"),),
    ),
    "herman2017": Work(
        "article",
        "Herman, J. and Usher, W.",
        "SALib: An open-source Python library for sensitivity analysis",
        "2017",
        (
            ("journal", "The Journal of Open Source Software"),
            ("volume", "2"),
            ("number", "9"),
            ("pages", "97"),
        ),
    ),
    "saltelli2010": Work(
        "article",
        "Saltelli, A. and Annoni, P. and Azzini, I. and Campolongo, F. and Ratto, M. and"
        " Tarantola, S.",
        "Variance based sensitivity analysis of model output. Design and estimator for the total"
        " sensitivity index",
        "2010",
        (
            ("journal", "Computer Physics Communications"),
            ("volume", "181"),
            ("pages", "259--270"),
        ),
    ),
}


# How people read what BibTeX writes.
READ: Final = {'{\\"u}': "ü", "{\\`e}": "è", "{": "", "}": ""}


def fixel() -> Work:
    """The program itself, in the version that runs."""
    return Work(
        "misc",
        "{The fixel authors}",
        "fixel: planar rigid bodies in frictional contact, solved as complementarity problems",
        "2026",
        (("note", f"Version {version('fixel')}, software"),),
    )


def works(keys: Sequence[str]) -> dict[str, Work]:
    """The program, and what is cited, each once; unknown keys are left out."""
    known = {key: WORKS[key] for key in dict.fromkeys(keys) if key in WORKS}
    return {"fixel": fixel(), **known}


def bibtex(cited: dict[str, Work]) -> str:
    """Entries of a `.bib` file."""
    return "\n".join(_entry(key, work) for key, work in cited.items())


def _entry(key: str, work: Work) -> str:
    fields = [("author", work.author), ("title", f"{{{work.title}}}"), ("year", work.year)]
    lines = [f"  {name} = {{{value}}}," for name, value in (*fields, *work.where)]
    return "\n".join([f"@{work.kind}{{{key},", *lines, "}", ""])


def line(work: Work) -> str:
    """As people read it."""
    authors = work.author.replace(" and others", " et al.").replace(" and ", ", ")
    for written, read in READ.items():
        authors = authors.replace(written, read)
    rest = [value.replace("--", "-") for name, value in work.where if name != "number"]
    parts = [f"{authors} ({work.year})", work.title, ", ".join(rest)]
    return ". ".join(part for part in parts if part) + "."
