"""Links from the names in docstrings and in code of the text to their pages.

A docstring writes `simulate`, `Scene` or `fixel.model.scene.Scene`. What is public becomes a link;
any other name is set as code, since most of them are arguments, units or values. In Markdown
`Scene`, `Scene.simulate` and `fixel.plan(...)` become links; `plan` alone may be a command.
"""

import re
from pathlib import Path

from docutils import nodes
from reference import public_names
from sphinx.addnodes import pending_xref
from sphinx_codeautolink.extension.cache import DataCache

import fixel

PUBLIC = set(public_names())
NAME = re.compile(r"(?:fixel\.(?=\w)|(?=[A-Z]))(\w+)(\.\w+)?")


def resolve(app, env, node: pending_xref, content: nodes.TextElement):
    if node.get("refdomain") != "py":
        return None
    target = node["reftarget"]
    head, _, last = target.rpartition(".")
    candidates = [f"fixel.{last}" if last in PUBLIC else "", f"fixel.{target}"]
    if (owner := head.rpartition(".")[2]) in PUBLIC:
        candidates.append(f"fixel.{owner}.{last}")
    domain = env.domains.python_domain
    for name in filter(None, candidates):
        if name in domain.objects:
            found = domain.resolve_xref(
                env, node["refdoc"], app.builder, "obj", name, node, content
            )
            if found is not None:
                return found
    return nodes.literal(target, content.astext(), classes=["code"])


def link(app, doctree: nodes.document) -> None:
    """Make references of the public names that a Markdown page has in its text."""
    if app.env.doc2path(app.env.docname).suffix != ".md":
        return
    for code in list(doctree.findall(nodes.literal)):
        found = NAME.match(code.astext())
        inside = isinstance(code.parent, nodes.title | nodes.reference | pending_xref)
        if not found or inside or found[1] not in PUBLIC:
            continue
        member = (found[2] or "").lstrip(".")
        known = member and hasattr(getattr(fixel, found[1]), member)
        target = f"fixel.{found[1]}" + (f".{member}" if known else "")
        reference = pending_xref(
            "", refdomain="py", reftype="obj", reftarget=target, refexplicit=True
        )
        reference["refdoc"] = app.env.docname
        code.replace_self(reference)
        reference += code


class AnyPage:
    """Folder in which every page is found: the extension looks for pages in .rst only.

    Without it a page in Markdown that is written again, but not read again, loses its links.
    """

    def __truediv__(self, name: str) -> Path:
        return Path(__file__)


def read_cache(cache: DataCache, read=DataCache.read) -> None:
    cache.src_dir = AnyPage()
    read(cache)


def setup(app):
    DataCache.read = read_cache
    app.connect("doctree-read", link)
    app.connect("missing-reference", resolve, priority=900)  # after intersphinx
    return {"parallel_read_safe": True, "parallel_write_safe": True}
