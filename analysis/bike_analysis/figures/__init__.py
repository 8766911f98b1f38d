"""From typed columns to numbers: figures, laps, comparisons and tables, and their JSON Schema."""
