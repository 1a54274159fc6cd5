"""Classes are abstract or final: those that have subclasses are listed here."""

import ast

from tools.house import PACKAGE

# Base classes of fixel, most of them abstract; all other classes are final, without a decorator.
BASES = """
    AbstractActuator AbstractEngine AbstractError AbstractFollower AbstractMotionModel
    AbstractOptimiser AbstractPhysicsEngine AbstractPool AbstractReplay AbstractSolver
    AbstractStepper AbstractTracking Analysis Answer BatchEnv CalibratedModel CalibrationPlan
    Clause Comparable FileRecord FixelError FrameSource GeneratorSearch Goal Importer JobProgress
    MarkRequest PartFollower PathComparison PoseTrack RequestBody Result Search SingleEnv
    Trajectory _AimedActuator _BuiltInMotion _BuiltInStepper _Fields _WithHint
"""


def test_only_listed_classes_have_subclasses():
    trees = [ast.parse(path.read_text()) for path in PACKAGE.rglob("*.py")]
    classes = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    own = {node.name for node in classes} - {"Worker"}  # of a page; another one is Dask's
    named = {ast.unparse(base).split("[")[0] for node in classes for base in node.bases}
    assert {name.rpartition(".")[2] for name in named} & own == {*BASES.split()}
