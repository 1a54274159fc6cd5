"""Environments of Gymnasium on the compiled engine: Push-T, pushes to a pose, and grasps.

Importing this package registers ``fixel/PushT-v0``, ``fixel/Push-v0`` and ``fixel/Grasp-v0``.
"""

from fixel.errors import MissingExtra

try:
    import gymnasium
except ModuleNotFoundError:
    raise MissingExtra("fixel.environments", "gymnasium", extra="gym") from None

gymnasium.register(
    "fixel/PushT-v0",
    entry_point="fixel.environments.push_t:PushTEnv",
    vector_entry_point="fixel.environments.push_t:PushTVectorEnv",
    max_episode_steps=300,
)
gymnasium.register(
    "fixel/Push-v0",
    entry_point="fixel.environments.push:PushEnv",
    vector_entry_point="fixel.environments.push:PushVectorEnv",
    max_episode_steps=100,
)
gymnasium.register(
    "fixel/Grasp-v0",
    entry_point="fixel.environments.grasp:GraspEnv",
    vector_entry_point="fixel.environments.grasp:GraspVectorEnv",
    max_episode_steps=3,
)
