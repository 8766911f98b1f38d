"""Circuit files that tests of several folders write."""

OVAL = """
format: bike.track/1
length_m: 1200
width_m: 12
elements:
  - {straight_m: 300}
  - {arc: {length_m: 300, angle_deg: 180}}
  - {straight_m: 300}
  - {arc: {length_m: 300, angle_deg: 180}}
elevation_m: [[0, 10], [300, 14], [600, 12], [900, 8]]
"""
"""Two straights and two half circles, with hills."""
