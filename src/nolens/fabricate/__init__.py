"""Files for the workshop, in memory: solids, layouts, height maps and the process sheet."""
