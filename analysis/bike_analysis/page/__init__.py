"""From numbers to what people look at: the report pages with their script and style, and the picture."""
