"""Links from the names in docstrings to their pages.

A docstring writes `simulate`, `Scene` or `fixel.model.scene.Scene`. What is public becomes a link;
any other name is set as code, since most of them are arguments, units or values.
"""

from docutils import nodes
from reference import public_names
from sphinx.addnodes import pending_xref

PUBLIC = set(public_names())


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


def setup(app):
    app.connect("missing-reference", resolve)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
