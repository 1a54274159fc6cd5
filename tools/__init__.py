"""Programs for the people who develop fixel; none is part of the package."""
