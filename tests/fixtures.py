"""Projects for tests of all rooms: built once for each module, or for each test that writes."""

from fixel.database.project import Project


def project_of(folder, experiments):
    """Create a project with these experiments, whose ids count from 1."""
    project = Project.create(folder)
    with project.store() as store:
        for experiment in experiments:
            store.add_experiment(experiment)
    return project
