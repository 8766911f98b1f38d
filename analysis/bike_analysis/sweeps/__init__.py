"""Results of a sweep: its two tables, figures with intervals, pictures and a report page."""
