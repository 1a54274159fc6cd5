"""Site templates: what they may say."""

from pathlib import Path

import pytest

from fixel.errors import InvalidInput
from fixel.io.document import yaml_text
from fixel.jobs.site import TEMPLATE, Site, load_site, site_of


def test_the_template_is_one(tmp_path):
    path = tmp_path / "site.yaml"
    path.write_text(TEMPLATE)
    assert load_site(path).queue == "main"
    everything = "\n".join(
        line.replace("# ", "", 1) if line.startswith("# ") and not line.startswith("# A") else line
        for line in TEMPLATE.splitlines()
    )
    path.write_text(everything)
    site = load_site(path)
    assert (site.account, site.directives, site.prologue) == (
        "my_group",
        ["--qos=long"],
        ["module load python/3.12"],
    )
    assert site.model_fields_set == set(Site.model_fields)


@pytest.mark.parametrize("name", ["department", "national_centre"])
def test_the_examples_are_sites(name):
    examples = Path(__file__).parents[2] / "examples" / "sites"
    assert load_site(examples / f"{name}.yaml").account


def test_a_site_is_read_back(tmp_path):
    site = Site(queue="a", walltime="2-00:00:00", prologue=["source x"], memory="1.5 GiB")
    path = tmp_path / "site.yaml"
    path.write_text(yaml_text(site.model_dump(exclude_none=True)))
    assert load_site(path) == site


@pytest.mark.parametrize(
    ("walltime", "seconds", "lifetime"),
    [("00:00:10", 10, 8), ("01:00:00", 3600, 3480), ("1-02:00:00", 93600, 93480)],
)
def test_a_worker_ends_before_its_time(walltime, seconds, lifetime):
    site = Site(walltime=walltime)
    assert (site.walltime_s, site.lifetime_s) == (seconds, lifetime)


@pytest.mark.parametrize(("content", "complaint"), [
    ({"walltime": "soon"}, "walltime is 'soon', but must be HH:MM:SS"),
    ({"walltime": 3600}, "walltime is 3600, but must be text"),
    ({"walltime": "00:00:01"}, "must be at least 00:00:10"),
    ({"wall_time": "01:00:00"},
     "wall_time: found an unknown key, but fixel needs one of scheduler"),
    ({"memory": "much"}, "memory is 'much', but must be a size such as 4 GB"),
    ({"cores": 0}, "cores is 0"),
    ({"max_jobs": -1}, "max_jobs is -1"),
    ({"queue": "a\n#SBATCH --uid=0"}, "queue is 'a.*', but must be one line"),
    ({"prologue": ["a\nb"]}, "prologue.0 is 'a.*b', but must be one line"),
    ({"directives": "--x"}, "directives is '--x', but must be a list"),
    ({"scheduler": "pbs"}, "scheduler is 'pbs', but must be 'slurm'"),
    ([], "must be a mapping with the keys scheduler, queue"),
])  # fmt: skip
def test_what_a_site_may_not_say(content, complaint):
    with pytest.raises(InvalidInput, match=complaint):
        site_of(content, "site.yaml")
