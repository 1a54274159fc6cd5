"""Programs that simulate a model in another engine; they import nothing of fixel.

Adapters of fixel call them, and `fixel.export_model` copies them next to a model.
"""
