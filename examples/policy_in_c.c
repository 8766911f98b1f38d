/* The shipped bicycle's policy without Python: it answers one state of the bicycle with a steering angle.

   bike export whipple --c bike_whipple.h && cc -O2 -std=c99 -I. examples/policy_in_c.c -o policy -lm && ./policy */

#include <stdio.h>

#include "bike_whipple.h"

int main(void) {
  /* Upright at 4 m/s on a straight line that lies 0.3 m to the left; rolling wheels of radius 0.35 m. */
  bike_whipple_inputs in = {.front_wheel_rate = 4.0f / 0.35f};
  const int points = (int)(sizeof in.preview_y / sizeof *in.preview_y);
  for (int k = 0; k < points; ++k) {
    in.preview_x[k] = 0.2f * (float)k;
    in.preview_y[k] = 0.3f;
  }
  float command[BIKE_WHIPPLE_ACTION];
  bike_whipple_answer(&in, command);
  printf("0.3 m right of the line: steer to %.3f rad\n", command[0]);
  in.roll = 0.05f;
  bike_whipple_answer(&in, command);
  printf("and leaning right by 0.05 rad: steer to %.3f rad\n", command[0]);
  return 0;
}
