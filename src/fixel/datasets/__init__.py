"""Import of recorded data as experiments: an importer per dataset, and one for your own tables."""

from fixel.datasets.base import Importer as Importer, ImportPlan as ImportPlan
from fixel.datasets.experiments import Experiments as Experiments
from fixel.datasets.reading import (
    IMPORTERS as IMPORTERS,
    example as example,
    importer_for as importer_for,
    plan_import as plan_import,
)
