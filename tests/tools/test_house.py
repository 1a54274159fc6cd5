"""The figures of `make house`: counted right, and never larger than they were."""

import pytest
from tools.doors import Capability, n_lines, statements
from tools.house import PACKAGE, measure, read_limits, tighten
from tools.source import circles, imports, reached, read_modules, references, upward

FILES = {
    "__init__.py": "",
    "cli/__init__.py": "",
    "calibration/__init__.py": "ENOUGH = 10\n",
    "model/__init__.py": "from fixel.model.scene import Told\n",
    "model/scene.py": (
        "from typing import TYPE_CHECKING\n"
        "if TYPE_CHECKING:\n"
        "    from fixel.model.body import Body\n"
        "class Told:\n"
        '    """Of the scene."""\n'
        "class Seed: ...\n"
    ),
    "model/body.py": (
        "def lazy():\n    import fixel.model.scene\nclass _Told: ...\nclass Body: ...\n"
    ),
    "model/alone.py": "from collections.abc import Callable\nSay = Callable[[str], None]\n",
    "web/__init__.py": "",
    "web/api/__init__.py": "",
    "web/api/app.py": "class SceneIn: ...\nclass SceneOut: ...\nclass Scene: ...\n",
    "workflows/calibration/run.py": (
        "from fixel.model import scene\nfrom ...web.api import app\n"
        "def calibrate(*, level=0.95): ...\n"
    ),
    "workflows/__init__.py": '"""Whoever reads this is told nothing.\n\nNothing anew.\n"""\n',
    "kernels/__init__.py": "",
    "kernels/rollout.py": (
        "def loop():\n    '''Walk.\n\n    On.\n    '''\n    while True:\n        break\n"
    ),
}


@pytest.fixture
def modules(tmp_path):
    for name, text in FILES.items():
        file = tmp_path / "fixel" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    return read_modules(tmp_path / "fixel")


def test_imports_are_found_wherever_they_stand(modules):
    edges = imports(modules)
    assert edges["fixel.workflows.calibration.run"] == {"fixel.model.scene", "fixel.web.api.app"}
    assert edges["fixel.model.scene"] == {"fixel.model.body"}  # under TYPE_CHECKING
    assert edges["fixel.model.body"] == {"fixel.model.scene"}  # inside a function
    assert edges["fixel.model"] == {"fixel.model.scene"}


def test_strings_that_name_a_higher_floor_are_references(modules):
    (modules["fixel.model"].file.parent / "hidden.py").write_text(
        '"""Not a reference: fixel.web.api.app."""\n'
        'HOME = "fixel.web.api.app:draw"\nBELOW = "fixel.kernels.rollout"\nPACKAGE = "fixel"\n'
    )
    package = modules["fixel"].file.parent
    edges = references(read_modules(package))
    assert edges["fixel.model.hidden"] == {"fixel.web.api.app", "fixel.kernels.rollout"}
    assert upward(edges, ["cli | web", "workflows", "model", "kernels"]) == [
        "fixel.model.hidden -> fixel.web.api.app",
        "fixel.workflows.calibration.run -> fixel.web.api.app",
    ]


def test_statements_of_an_option_are_counted_at_every_door(tmp_path):
    files = {
        "__init__.py": "",
        "workflows/map.py": (
            "def run(data, *, level=0.9, name=''):\n"
            "    '''Map.\n\n    Parameters\n    ----------\n    level : float\n    '''\n"
            "    return draw(level=level)\n"
        ),
        "web/map.js": "form.level = 1;\nlevels = 2;\n",
        "cli/map.py": "FLAG = '--level'\nTEXT = 'the level'\n",
        "cli/other.py": "level: float = 1\n",
        "map/core.py": "level = 1\n" * 11,
    }
    for name, text in files.items():
        file = tmp_path / "fixel" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    capability = Capability("fixel.workflows.map.run", "map", "map")
    modules = read_modules(tmp_path / "fixel")
    assert capability.options(modules) == ("level",)  # "name" has other meanings
    assert statements(capability, modules) == [
        "fixel/cli/map.py:1 level (key)",
        "fixel/workflows/map.py:1 level (declared)",
        "fixel/workflows/map.py:8 level (passed on)",
        "fixel/workflows/map.py:1 level (docstring)",
        "fixel/web/map.js:1 level (js)",
    ]
    assert n_lines(capability, modules) == (10, 11)


def test_circles_and_reach(modules):
    edges = imports(modules)
    assert circles(edges) == [["fixel.model.body", "fixel.model.scene"]]
    run = "fixel.workflows.calibration.run"
    assert reached(edges, run) == {
        run, "fixel.model.scene", "fixel.model.body", "fixel.web.api.app",
    }  # fmt: skip


def test_each_figure_counts_what_it_says(modules):
    figures = measure(modules)
    assert figures["repeated_class_names"].places == (
        "Told: fixel/model/body.py, fixel/model/scene.py",
    )
    assert [place.split()[-1] for place in figures["participle_classes"].places] == [
        "_Told", "Told",
    ]  # fmt: skip
    assert [place.split()[-1] for place in figures["web_mirrors"].places] == ["SceneIn", "SceneOut"]
    assert figures["progress_aliases"].value == 1
    assert figures["rollout_loop"].value == 3  # the docstring does not count
    assert figures["fragments"].value == pytest.approx(33.3)
    assert figures["banned_words"].value == 3
    assert figures["lines"].value == sum(text.count("\n") for text in FILES.values())


def test_limits_are_lowered_and_never_raised(tmp_path, monkeypatch, modules):
    figures = measure(modules)
    monkeypatch.setattr("tools.house.LIMITS", tmp_path / "limits.toml")
    limits = {name: figure.value + 5 for name, figure in figures.items()} | {"circles": 0}
    (tmp_path / "limits.toml").write_text(
        "".join(f"{name} = {value}  # why\n" for name, value in limits.items())
    )
    tighten(limits, figures)
    assert read_limits() == {name: f.value for name, f in figures.items()} | {"circles": 0}
    assert (tmp_path / "limits.toml").read_text().count("# why") == len(figures)


@pytest.mark.system
def test_no_figure_exceeds_its_limit():
    figures = measure(read_modules(PACKAGE))
    limits = read_limits()
    assert list(limits) == list(figures)
    worse = {
        name: (figure.value, limits[name])
        for name, figure in figures.items()
        if figure.value > limits[name]
    }
    assert not worse, f"{worse}: `make house ARGS='--list FIGURE'` names the places"
