"""Sphinx configuration of the documentation; `make docs` builds it."""

import os
import sys
from importlib.metadata import distribution
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))
os.environ.setdefault("MPLBACKEND", "agg")
# The gallery runs the command `fixel` of this environment.
os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"

import reference  # noqa: E402
import repository  # noqa: E402

reference.write_pages(HERE / "reference")
repository.write_pages()
for page in (HERE / "gallery").glob("*.rst"):  # of a script that was renamed
    if page.stem != "index" and not (HERE.parent / f"examples/gallery/{page.stem}.py").exists():
        page.unlink()

project = "fixel"
author = "The fixel authors"
copyright = "The fixel authors. Apache-2.0"
version = release = distribution("fixel").version

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.intersphinx",
    "sphinx.ext.viewcode",
    "numpydoc",
    "sphinx.ext.mathjax",
    "sphinx_codeautolink",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
    "sphinxcontrib.bibtex",
    "names",
    "repository",
]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["reference/generated", "gallery/*.py", "gallery/*.ipynb", "**/*.codeobj.json"]
templates_path = ["_templates"]
nitpicky = True
# The configuration of the gallery names functions, which Sphinx cannot store between builds; the
# gallery links most of its code itself.
suppress_warnings = ["config.cache", "codeautolink.match_name"]

# --- text ------------------------------------------------------------

myst_enable_extensions = ["attrs_inline", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
# A link to a folder or a file of the repository that is no page, such as a scene, copies the file.
bibtex_bibfiles = ["../src/fixel/workflows/report/references.bib"]
bibtex_default_style = "plain"
bibtex_reference_style = "author_year"

# --- reference ------------------------------------------------------------

autosummary_generate = ["reference/api.rst"]
autosummary_ignore_module_all = False
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_class_signature = "mixed"
autodoc_preserve_defaults = True
numpydoc_show_class_members = False
numpydoc_xref_param_type = True
numpydoc_xref_ignore = "all"  # but the public names
numpydoc_xref_aliases = {
    **{name: f":obj:`{name} <fixel.{name}>`" for name in reference.public_names()},
    **{name: f":obj:`{name} <numpy.{name}>`" for name in ("float64", "int64", "uint8", "ndarray")},
    **{name: f":obj:`{name}`" for name in ("bool", "dict", "float", "int", "list", "str", "tuple")},
    "array_like": ":obj:`array_like <numpy.typing.ArrayLike>`",
    "callable": ":obj:`callable <collections.abc.Callable>`",
    "iterable": ":obj:`iterable <collections.abc.Iterable>`",
    "mapping": ":obj:`mapping <collections.abc.Mapping>`",
    "None": ":obj:`None`",
    "path": ":obj:`path <pathlib.Path>`",
    "sequence": ":obj:`sequence <collections.abc.Sequence>`",
    **{name: f":obj:`{name}`" for name in ("matplotlib.axes.Axes", "pathlib.Path")},
}
default_role = "py:obj"
# The names that pages use, by hand: the site is built without network.
intersphinx_mapping = {
    name: (f"https://{address}", f"_inventories/{name}.txt")
    for name, address in {
        "python": "docs.python.org/3",
        "numpy": "numpy.org/doc/stable",
        "scipy": "docs.scipy.org/doc/scipy",
        "matplotlib": "matplotlib.org/stable",
        "pandas": "pandas.pydata.org/docs",
        "pyarrow": "arrow.apache.org/docs/python",
    }.items()
}
viewcode_line_numbers = True
codeautolink_concat_default = True  # the blocks of a page run as one script
codeautolink_autodoc_inject = False
codeautolink_inventory_map = reference.members_by_home()
codeautolink_warn_on_missing_inventory = False
codeautolink_warn_on_failed_resolve = False
copybutton_selector = (
    "div:not(.highlight-text, .highlight-none, .sphx-glr-script-out) > .highlight > pre"
)
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

# --- gallery ------------------------------------------------------------

sphinx_gallery_conf = {
    "examples_dirs": "../examples/gallery",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "sphinx_gallery.sorting.FileNameSortKey",
    "backreferences_dir": "reference/generated/examples",
    "doc_module": ("fixel",),
    "abort_on_example_error": True,
    "ignore_repr_types": r"matplotlib|numpy\.ndarray|'list'|'dict'|'tuple'",
    "only_warn_on_example_error": False,
    "write_computation_times": False,
    "min_reported_time": 1e9,
    "show_signature": False,
    "download_all_examples": False,
    "remove_config_comments": True,
    "copyfile_regex": "",
    "default_thumb_file": str(HERE / "pictures" / "grasp.png"),
}

# --- pages ------------------------------------------------------------

html_theme = "pydata_sphinx_theme"
html_title = f"fixel {version}"
# One file of MathJax 3, which draws formulas as SVG without any other file or request. Version 4
# fetches fonts; MathML looks different on every machine, and poor where no font has a MATH table.
MATHJAX = "sphinx-mathjax-offline"
html_favicon = "../src/fixel/web/static/icon.svg"
html_search_scorer = str(HERE / "_ext" / "search.js")
html_static_path = [
    "_static",
    str(distribution(MATHJAX).locate_file(f"{MATHJAX}/static/mathjax/tex-svg.js")),
]
mathjax_path = "tex-svg.js"
mathjax3_config = {"options": {"enableMenu": False}}
html_css_files = ["fixel.css"]
html_copy_source = False
html_show_search_summary = False  # a page opened from a file may not read other files
html_show_sourcelink = False
html_show_sphinx = False
html_permalinks_icon = "#"
html_context = {"default_mode": "auto"}
html_theme_options = {
    "logo": {"text": f"fixel {version}"},
    "header_links_before_dropdown": 8,
    "navbar_persistent": ["search-button"],
    "navbar_end": ["theme-switcher"],
    "navigation_with_keys": False,
    "show_toc_level": 2,
    "footer_start": ["copyright"],
    "footer_end": [],
    "secondary_sidebar_items": {"**": ["page-toc"], "index": []},
    "pygments_light_style": "tango",
    "pygments_dark_style": "monokai",
}
html_sidebars = {"index": [], "get-started": [], "gallery/index": []}
