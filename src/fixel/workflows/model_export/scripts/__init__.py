"""Programs that `fixel.export_model` copies next to a model; they import nothing of fixel."""
