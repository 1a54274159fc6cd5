"""Pages of a project: one module per page, with `pages(desk) -> list[Page]`.

`Page.place` orders the navigation: Experiments 10, Compare 20, Calibrations 30, Domain 40,
Simulate 50, Jobs 60, System 70, API 90.
"""
