"""From a file to typed columns: the MCAP container, CDR messages, clocks, and the rides of a recording."""
