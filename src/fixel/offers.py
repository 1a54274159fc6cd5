"""Table of the plots, stores and functions that upper floors offer to lower ones.

`register_all` copies it to `fixel.registry` when `fixel` is imported.
"""

from collections.abc import Mapping
from typing import Final

from fixel.registry import register

# Plots by class of the result; the usual one first.
PLOTS: Final[Mapping[str, Mapping[str, str]]] = {
    "Calibration": {
        "parameters": "fixel.workflows.calibration.report:fit_parameters_chart",
        "profiles": "fixel.workflows.calibration.report:fit_profiles_chart",
        "search": "fixel.workflows.calibration.report:fit_search_chart",
        "starts": "fixel.workflows.calibration.report:fit_starts_chart",
        "errors": "fixel.workflows.calibration.report:fit_errors_chart",
    },
    "Calibrations": {"parameters": "fixel.workflows.calibration.report:each_fit_chart"},
    "Comparison": {
        "errors": "fixel.drawing.experiment:plot_errors",
        "motion": "fixel.drawing.experiment:motion_figure",
    },
    "DomainMap": {
        "map": "fixel.drawing.domain:claimed_map_chart",
        "size": "fixel.drawing.domain:size_chart",
    },
    "ErrorBound": {"bounds": "fixel.drawing.domain:draw_bounds"},
    "Experiment": {
        "motion": "fixel.drawing.experiment:experiment_figure",
        "path": "fixel.drawing.experiment:plot_path",
    },
    "Experiments": {"paths": "fixel.drawing.experiment:plot_paths"},
    "Explanation": {
        "causes": "fixel.drawing.planning:causes_chart",
        "success": "fixel.drawing.planning:success_curves_chart",
    },
    "FilterRun": {"run": "fixel.drawing.filtering:filter_figure"},
    "BatchResult": {"ends": "fixel.drawing.sensitivity:runs_chart"},
    "NextPushes": {"pushes": "fixel.drawing.parts:next_pushes_chart"},
    "OrientingPlan": {"angles": "fixel.drawing.planning:orienting_figure"},
    "PartModel": {"errors": "fixel.drawing.parts:left_out_chart"},
    "Posterior": {"parameters": "fixel.drawing.uncertainty:corner_chart"},
    "Prediction": {
        "ends": "fixel.drawing.sensitivity:prediction_chart",
        "bands": "fixel.drawing.uncertainty:prediction_bands_chart",
    },
    "PushPlan": {
        "paths": "fixel.drawing.planning:paths_chart",
        "capture": "fixel.drawing.planning:capture_chart",
        "looks": "fixel.drawing.planning:looks_chart",
    },
    "Sensitivity": {
        "ends": "fixel.drawing.sensitivity:sensitivity_chart",
        "indices": "fixel.drawing.sensitivity:indices_chart",
    },
    "Simulation": {"motion": "fixel.drawing.picture:plot_simulation"},
    "TableMap": {"map": "fixel.drawing.parts:map_chart"},
    "TableCheck": {"pairs": "fixel.drawing.parts:table_chart"},
    "SuccessProbability": {"draws": "fixel.drawing.planning:success_chart"},
    "Trials": {"evidence": "fixel.drawing.planning:trials_chart"},
}

OFFERS: Final[Mapping[str, Mapping[str, str]]] = {
    **{f"plots of {result}": plots for result, plots in PLOTS.items()},
    # How a project stores a result, by the class of the result.
    "stores": {
        "Calibration": "fixel.workflows.calibration.stored:add_to_project",
        "Calibrations": "fixel.workflows.calibration.stored:add_to_project",
        "DomainMap": "fixel.workflows.capabilities:store_map",
        "FilterRun": "fixel.workflows.filtering.report:store_run",
        "Posterior": "fixel.workflows.uncertainty.report:store_posterior",
        "Sensitivity": "fixel.workflows.sensitivity.report:store_sensitivity",
    },
    "programs": {"serve": "fixel.simulation.engines.serve"},
    # What methods of a project call.
    "project": {
        "analyses": "fixel.workflows.analysis:load_analyses",
        "backup": "fixel.workflows.project.maintenance:backup",
        "calibrate": "fixel.workflows.calibration.run:calibrate",
        "call": "fixel.workflows.capabilities:call",
        "check": "fixel.workflows.project.maintenance:check",
        "check_place": "fixel.database.stored_content:check_place",
        "export": "fixel.workflows.project.export:export",
        "jobs": "fixel.workflows.jobs:jobs_in",
        "report": "fixel.workflows.report.write:report",
        "trust_place": "fixel.database.stored_content:trust_place",
        "upgrade": "fixel.workflows.project.maintenance:upgrade",
    },
    # What methods of scenes, experiments and results call.
    "methods": {
        "animate": "fixel.drawing:animate_simulation",
        "compare": "fixel.workflows.project.comparison:compare",
        "load_scene": "fixel.formats:load_scene",
        "read_outline": "fixel.formats.outline_file:read_outline",
        "plot": "fixel.drawing.chart:plot",
        "player": "fixel.web.views.notebook_player:player_of_simulation",
        "save": "fixel.io.saved:save",
        "prepare": "fixel.workflows.capabilities:prepare",
        "prepare_in": "fixel.workflows.capabilities:prepare_in",
        "request_of": "fixel.workflows.capabilities:request_of",
        "scene_file": "fixel.formats:SceneFile",
        "save_scene": "fixel.formats:save_scene",
        "thumbnail": "fixel.drawing.thumbnail:thumbnail",
    },
    # Capabilities whose commands results repeat.
    "capability": {"calibrate": "fixel.workflows.calibration.run:CALIBRATE"},
    # Modules with functions that files of a job may name.
    "jobs": {
        "calibration": "fixel.workflows.calibration.plan",
        "capability": "fixel.workflows.capabilities",
        "plan": "fixel.workflows.planning.rounds",
        "toy": "fixel.testing.toy_work",
    },
    # Classes that saved results may contain. None of them opens a file or starts a process.
    "saved classes": {
        "fixel.calibration.known_pushes": "KnownPushes",
        "fixel.calibration.noise": "Noise",
        "fixel.calibration.result": "CalibratedValues CalibrationResult ParameterSet",
        "fixel.calibration.study": "Trace",
        "fixel.calibration.target": "Target",
        "fixel.datasets.experiments": "ExperimentEntry Experiments",
        "fixel.domain.cells": "CellAxis Cells",
        "fixel.domain.claim": "Claim",
        "fixel.domain.domain": "DomainMap",
        "fixel.domain.evidence": "HeldOutErrors",
        "fixel.domain.push_bound": "ErrorBound LeftOutErrors",
        "fixel.domain.surface": "Surface",
        "fixel.filtering.recorded": "FilterMisfit FilterRun",
        "fixel.filtering.particle_filter": "ParticleFilter UniformPrior",
        "fixel.model.bodies": "Body Fixel LineDrive PathDrive Pusher Spring",
        "fixel.model.experiment": "Channel Experiment Flag Provenance",
        "fixel.model.goals": "AllOf AnyOf Beyond Contact Exit ForceAbove Inside PoseRegion Seated",
        "fixel.model.parameters": "Parameters",
        "fixel.model.probability": "Probability",
        "fixel.model.records": "CalibrationRecord Estimate Evaluations FilterParameters"
        " FilterRecord Member ProfileRecord SimulationRecord",
        "fixel.model.scene": "PairFriction Scene",
        "fixel.model.selection": "ExperimentDetails ExperimentRow",
        "fixel.model.shape": "Disk Polygon",
        "fixel.model.space": "Parameter ParameterSpace Unknown",
        "fixel.model.support": "Ellipsoid FrictionMap LoadMap NoSupport Plane SupportPoints Tripod"
        " UniformPressure",
        "fixel.model.trajectory": "Pose Trajectory",
        "fixel.parts.left_out": "LeftOutEnds",
        "fixel.parts.model": "PartModel",
        "fixel.parts.next_pushes": "NextPushes",
        "fixel.parts.fit": "PartValues",
        "fixel.parts.table_fit": "OwnFit",
        "fixel.parts.table_map": "BoardShift MapJudgement TableMap",
        "fixel.parts.table_check": "TableCheck TableEffect",
        "fixel.planning.belief": "Belief RigError Scenarios",
        "fixel.planning.causes": "Explanation FailureRegion UnknownEffect",
        "fixel.planning.held_out": "HeldSuccess",
        "fixel.planning.orienting": "OrientingPlan PushFunction",
        "fixel.planning.corrections": "CorrectionTable",
        "fixel.planning.looks": "Looks Walk",
        "fixel.planning.plan": "PlanRuns PushPlan",
        "fixel.planning.pushes": "FreePushes PlanPush RigPush RigPushes",
        "fixel.planning.success": "SuccessProbability",
        "fixel.planning.trials": "PlanTrial Trials",
        "fixel.simulation.motion": "Dynamic FirstOrder OtherEngine QuasiStatic",
        "fixel.simulation.result": "Accuracy BatchResult PusherTrajectory Simulation",
        "fixel.simulation.rollouts": "RolloutCase",
        "fixel.simulation.stepping": "Adaptive GaussSeidel Lemke Midpoint Newton StewartTrinkle",
        "fixel.uncertainty.error_terms": "ModelError StartError",
        "fixel.uncertainty.indices": "Factor Indices",
        "fixel.uncertainty.outcomes": "PoseSpread Sensitivity",
        "fixel.uncertainty.posterior": "Mode Posterior",
        "fixel.uncertainty.prediction": "Prediction",
        "fixel.uncertainty.predictive": "EndError",
        "fixel.uncertainty.run_to_run": "RunToRun",
        "fixel.workflows.calibration.calibration": "Calibration Calibrations",
        "fixel.workflows.calibration.request": "CalibrationRequest NamedOptions",
        "fixel.workflows.planning.request": "FoundPlan PlanFile PlanRequest",
        "fixel.workflows.project.compare": "PathComparison RunComparison",
        "fixel.workflows.project.comparison": "ComparedModel Comparison",
    },
}


def register_all() -> None:
    """Fill the registry; nothing is imported yet."""
    for kind, own in OFFERS.items():
        register(kind, own)
