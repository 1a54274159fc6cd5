"""Integer codes of the kernels, with their messages."""

from typing import Final

# Status of a step or a rollout.
CONVERGED: Final = 0
JAMMED: Final = 1
MAX_ITERATIONS: Final = 2
NON_FINITE: Final = 3
CONTACT_OVERFLOW: Final = 4
STEP_TOO_SMALL: Final = 5
MAX_STEPS: Final = 6
THROWN: Final = 7
INTERRUPTED: Final = 8
ENGINE_FAILED: Final = 9

# What a stepper decides besides: to take its last step back, or to try another length.
UNDO: Final = -2
RETRY: Final = -3

STATUS_NAMES: Final = (
    "converged",
    "jammed",
    "max_iterations",
    "non_finite",
    "contact_overflow",
    "step_too_small",
    "max_steps",
    "thrown",
    "interrupted",
    "engine_failed",
)

STATUS_ADVICE: Final = (
    "",
    "The pusher pushes against bodies that cannot move. If it has no force_limit, set one (the "
    "actuator of the thesis stalls at 34.3 N); or shorten its travel.",
    "No solver of the chain met the tolerance in this step. Use a smaller step or another solver.",
    "A number overflowed. Check the units of masses, sizes and speeds.",
    "There are more contacts than max_contacts. Increase max_contacts.",
    "The stepper could not meet its tolerance at the smallest step. Increase the tolerance, or "
    "use a fixed step.",
    "The stepper reached max_steps. Increase max_steps or the tolerance.",
    "A body was pushed out of an overlap and moved further in one step than the step resolves. "
    "Check for a deep overlap at the start, or use a smaller step.",
    "The run was interrupted. Run it again to complete it.",
    "Another engine gave no usable answer. Check its choices, or use fixel's own engine.",
)

# Advice for JAMMED where every pusher has a force_limit.
JAMMED_AT_LIMIT: Final = (
    "Friction wedges the bodies, and the solver found no forces that hold them. Shorten the travel "
    "of the pusher, or use a fixed step."
)

# A motion model or solver of a plug-in, which only the plain Python loop can run.
EXTERNAL: Final = -1

# Which equations move the bodies.
DYNAMIC: Final = 0
QUASI_STATIC: Final = 1
FIRST_ORDER: Final = 2

# Which solver solves the step's problem.
NEWTON: Final = 0
GAUSS_SEIDEL: Final = 1

# Kinds of support friction elements.
POINT: Final = 0
ELLIPSOID: Final = 1
