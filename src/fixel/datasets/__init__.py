"""Import of recorded data as experiments: an importer per dataset, and one for your own tables."""

from fixel.datasets.base import Importer, ImportPlan
from fixel.datasets.experiments import Experiments
from fixel.datasets.reading import IMPORTERS, example, importer_for, plan_import

__all__ = [
    "IMPORTERS",
    "Experiments",
    "ImportPlan",
    "Importer",
    "example",
    "importer_for",
    "plan_import",
]
