"""Report of a calibration on one page: data, parameters, errors, and their reliability."""
