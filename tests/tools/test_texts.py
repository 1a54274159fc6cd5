"""Texts that users read are found wherever they stand, and their faults are named."""

from textwrap import dedent

import pytest
from tools.source import read_modules
from tools.texts import REJECTED, Text, read_documents, read_texts

FILES = {
    "__init__.py": '"""Nobody reads this docstring here."""\nNAME = "no_text"\n',
    "cli.py": """
        SEED = option(0, help="Of everything random.")
        raise InvalidInput(f"file {name}", found="what nobody knows", hint="a" "b c")
        SQL = "SELECT name FROM told WHERE said"
    """,
    "page.html": """
        <h1 title="Told {{ a }}">{# Nobody #}To <b>whom</b></h1>{% if told %}<pre>told me so</pre>
    """,
    "page.js": "// it told\nlet a = 'x-y'; say(`Kept ${a ? `as ${a}` : 'it {so'}.`); /* told */\n",
    "report.txt": "{% block told %}\n- One {{ value }}\n  sentence.\n- Another{{ 'a b' }}.\n",
}


@pytest.fixture
def texts(tmp_path):
    for name, text in FILES.items():
        file = tmp_path / "fixel" / name
        file.parent.mkdir(exist_ok=True)
        file.write_text(dedent(text))
    return list(read_texts(read_modules(tmp_path / "fixel")))


def test_texts_are_found_with_their_places(texts):
    assert sorted((t.place.removeprefix("fixel/"), t.text) for t in texts) == [
        ("cli.py:2", "Of everything random."),
        ("cli.py:3", "ab c"),
        ("cli.py:3", "file X"),
        ("cli.py:3", "what nobody knows"),
        ("page.html:2", "To whom"),
        ("page.html:2", "Told X"),
        ("page.js:2", "Kept X."),
        ("page.js:2", "as X"),
        ("page.js:2", "it {so"),
        ("report.txt:2", "One X sentence."),
        ("report.txt:4", "AnotherX."),
    ]
    assert [t.text for t in texts if t.is_alone] == ["Of everything random."]


def test_faults():
    assert list(Text("", "Nobody kept it anew.").faults) == ["Nobody", "kept", "anew"]
    assert list(Text("", "Between two values", is_alone=True).faults) == ["Between..."]
    assert list(Text("", " ".join(["word"] * 33) + ".").faults) == ["33 words"]
    assert list(Text("", "There is no scene; the file is no longer there.").faults) == []
    assert list(Text("", "Seed of the random number generator.", is_alone=True).faults) == []
    assert all(REJECTED.values())  # each with its reason


def test_documents_are_read_without_code_formulas_addresses_and_titles(tmp_path):
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "page.md").write_text(
        "# Told\n\nSee [this](said.md) with `told` and *Said*,\nfor $x$.\n\n    told --anew\n\n"
        "```\nnobody\n```\n- One\n- Two\n\n| a | b |\n|---|---|\n| c | told |\n\n$$ told $$\n"
        "\n## Sources\n\nNobody (1999).\n"
    )
    assert [(t.place.rpartition(":")[2], t.text) for t in read_documents(tmp_path)] == [
        ("1", "Told"), ("3", "See [thisX with X and X, for X."), ("11", "One"), ("12", "Two"),
        ("14", "a"), ("14", "b"), ("16", "c"), ("16", "told"),
    ]  # fmt: skip
