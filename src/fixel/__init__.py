"""Planar rigid bodies in frictional contact: simulate, calibrate, and know where to trust it.

The public names are imported when first used, so that `import fixel` and `fixel --help` stay light.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from fixel.offers import register_all

if TYPE_CHECKING:
    from fixel.calibration.noise import Noise as Noise
    from fixel.calibration.usual_parameters import known_parameters as known_parameters
    from fixel.database.project import Project as Project
    from fixel.datasets import Experiments as Experiments
    from fixel.domain.domain import DomainMap as DomainMap
    from fixel.domain.push_bound import ErrorBound as ErrorBound
    from fixel.errors import (
        FixelError as FixelError,
        Interrupted as Interrupted,
        InvalidInput as InvalidInput,
        MissingExtra as MissingExtra,
        SolveFailed as SolveFailed,
        StoreRefused as StoreRefused,
    )
    from fixel.filtering.recorded import FilterRun as FilterRun
    from fixel.formats import load_scene as load_scene
    from fixel.io.saved import load as load
    from fixel.model import (
        AllOf as AllOf,
        AnyOf as AnyOf,
        Beyond as Beyond,
        Body as Body,
        Contact as Contact,
        Disk as Disk,
        Ellipsoid as Ellipsoid,
        Exit as Exit,
        Experiment as Experiment,
        Fixel as Fixel,
        ForceAbove as ForceAbove,
        Goal as Goal,
        Inside as Inside,
        LineDrive as LineDrive,
        LoadMap as LoadMap,
        NoSupport as NoSupport,
        PairFriction as PairFriction,
        Parameters as Parameters,
        PathDrive as PathDrive,
        Plane as Plane,
        PlannedExperiment as PlannedExperiment,
        Polygon as Polygon,
        Pose as Pose,
        PoseRegion as PoseRegion,
        Pusher as Pusher,
        Scene as Scene,
        Seated as Seated,
        SupportPoints as SupportPoints,
        Trajectory as Trajectory,
        Tripod as Tripod,
        UniformPressure as UniformPressure,
    )
    from fixel.model.records import Estimate as Estimate
    from fixel.model.space import Parameter as Parameter
    from fixel.parts.next_pushes import push_candidates as push_candidates
    from fixel.parts.model import PartModel as PartModel
    from fixel.parts.next_pushes import NextPushes as NextPushes
    from fixel.parts.table_map import TableMap as TableMap
    from fixel.parts.table_check import TableCheck as TableCheck
    from fixel.planning.orienting import (
        orienting_plan as orienting_plan,
        OrientingPlan as OrientingPlan,
    )
    from fixel.planning.belief import Belief as Belief, RigError as RigError
    from fixel.planning.plan import PushPlan as PushPlan
    from fixel.planning.pushes import FreePushes as FreePushes, RigPushes as RigPushes
    from fixel.simulation import (
        Adaptive as Adaptive,
        BatchResult as BatchResult,
        Dynamic as Dynamic,
        FirstOrder as FirstOrder,
        GaussSeidel as GaussSeidel,
        Lemke as Lemke,
        Newton as Newton,
        QuasiStatic as QuasiStatic,
        simulate as simulate,
        simulate_batch as simulate_batch,
        Simulation as Simulation,
        Simulator as Simulator,
        StewartTrinkle as StewartTrinkle,
    )
    from fixel.testbed.simulated import SimulatedTestbed as SimulatedTestbed
    from fixel.uncertainty.outcomes import Sensitivity as Sensitivity
    from fixel.uncertainty.posterior import Posterior as Posterior
    from fixel.uncertainty.prediction import Prediction as Prediction
    from fixel.uncertainty.run_to_run import (
        learn_run_to_run as learn_run_to_run,
        RunToRun as RunToRun,
    )
    from fixel.uncertainty.error_terms import StartError as StartError
    from fixel.workflows.calibration.calibration import (
        Calibration as Calibration,
        Calibrations as Calibrations,
    )
    from fixel.workflows.calibration.run import (
        calibrate as calibrate,
        calibrate_campaign as calibrate_campaign,
        calibrate_each as calibrate_each,
    )
    from fixel.workflows.error_bound import error_bound as error_bound
    from fixel.workflows.domain.run import map_domain as map_domain
    from fixel.workflows.experiments import read_experiments as read_experiments
    from fixel.workflows.filtering.run import filter as filter
    from fixel.workflows.model_export.run import export_model as export_model
    from fixel.workflows.parts import part_model as part_model
    from fixel.workflows.planning.execute import run_on_testbed as run_on_testbed
    from fixel.workflows.planning.run import plan as plan
    from fixel.workflows.project.comparison import compare as compare, Comparison as Comparison
    from fixel.workflows.project.export import export as export
    from fixel.workflows.report.write import report as report
    from fixel.workflows.sensitivity.run import sensitivity as sensitivity
    from fixel.workflows.prediction import predict as predict
    from fixel.workflows.table_map import table_map as table_map
    from fixel.workflows.table_check import table_check as table_check
    from fixel.workflows.uncertainty.run import posterior as posterior

    __version__: str

register_all()

# Public names by module. A new one also joins the imports above, which type checkers read.
_NAMES = {
    "fixel.calibration.noise": "Noise",
    "fixel.calibration.usual_parameters": "known_parameters",
    "fixel.database.project": "Project",
    "fixel.datasets": "Experiments",
    "fixel.domain.domain": "DomainMap",
    "fixel.domain.push_bound": "ErrorBound",
    "fixel.errors": "FixelError Interrupted InvalidInput MissingExtra SolveFailed StoreRefused",
    "fixel.filtering.recorded": "FilterRun",
    "fixel.formats": "load_scene",
    "fixel.io.saved": "load",
    "fixel.model": "AllOf AnyOf Beyond Body Contact Disk Ellipsoid Exit Experiment Fixel ForceAbove"
    " Goal Inside LineDrive LoadMap NoSupport PairFriction Parameters PathDrive Plane"
    " PlannedExperiment Polygon Pose PoseRegion Pusher Scene Seated SupportPoints Trajectory"
    " Tripod UniformPressure",
    "fixel.model.records": "Estimate",
    "fixel.model.space": "Parameter",
    "fixel.parts.model": "PartModel",
    "fixel.parts.next_pushes": "NextPushes push_candidates",
    "fixel.parts.table_map": "TableMap",
    "fixel.parts.table_check": "TableCheck",
    "fixel.planning.orienting": "orienting_plan OrientingPlan",
    "fixel.planning.belief": "Belief RigError",
    "fixel.planning.plan": "PushPlan",
    "fixel.planning.pushes": "FreePushes RigPushes",
    "fixel.simulation": "Adaptive BatchResult Dynamic FirstOrder GaussSeidel Lemke Newton"
    " QuasiStatic simulate simulate_batch Simulation Simulator StewartTrinkle",
    "fixel.testbed.simulated": "SimulatedTestbed",
    "fixel.uncertainty.outcomes": "Sensitivity",
    "fixel.uncertainty.posterior": "Posterior",
    "fixel.uncertainty.prediction": "Prediction",
    "fixel.uncertainty.run_to_run": "learn_run_to_run RunToRun",
    "fixel.uncertainty.error_terms": "StartError",
    "fixel.workflows.calibration.calibration": "Calibration Calibrations",
    "fixel.workflows.calibration.run": "calibrate calibrate_campaign calibrate_each",
    "fixel.workflows.error_bound": "error_bound",
    "fixel.workflows.domain.run": "map_domain",
    "fixel.workflows.experiments": "read_experiments",
    "fixel.workflows.filtering.run": "filter",
    "fixel.workflows.model_export.run": "export_model",
    "fixel.workflows.parts": "part_model",
    "fixel.workflows.planning.execute": "run_on_testbed",
    "fixel.workflows.planning.run": "plan",
    "fixel.workflows.project.comparison": "compare Comparison",
    "fixel.workflows.project.export": "export",
    "fixel.workflows.report.write": "report",
    "fixel.workflows.sensitivity.run": "sensitivity",
    "fixel.workflows.prediction": "predict",
    "fixel.workflows.table_map": "table_map",
    "fixel.workflows.table_check": "table_check",
    "fixel.workflows.uncertainty.run": "posterior",
}
_HOME_OF = {name: module for module, names in _NAMES.items() for name in names.split()}

# `filter` is public, but a star import must not hide the built-in.
__all__ = sorted({*_HOME_OF, "__version__"} - {"filter"})


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("fixel")
    elif name in ("datasets", "units"):
        value = import_module(f"fixel.{name}")
    elif name in _HOME_OF:
        value = getattr(import_module(_HOME_OF[name]), name)
    else:
        raise AttributeError(f"module 'fixel' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, "datasets", "filter", "units"})
