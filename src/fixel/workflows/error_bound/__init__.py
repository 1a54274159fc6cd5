"""Error bounds of untried pushes: computation, report, stored fits."""
