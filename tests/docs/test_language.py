"""The language of the documentation: no rejected words, no sentences that are too long."""

from pathlib import Path

from tools.texts import read_documents

ROOT = Path(__file__).parents[2]
GENERATED = ("docs/gallery", "docs/reference/api", "docs/reference/commands", "docs/project/")
GENERATED += ("docs/reference/generated",)


def test_documentation_follows_the_language_rule() -> None:
    faults = [
        f"{text.place} {fault}: {text.text}"
        for text in read_documents(ROOT)
        if not text.place.startswith(GENERATED)
        for fault in text.faults
    ]
    assert not faults, "\n".join(faults)
