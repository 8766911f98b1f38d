"""The Whipple bicycle: equations of motion, engines, linear modes and steady turns."""
