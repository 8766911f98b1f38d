"""Equations of motion of the nonlinear Whipple bicycle. Written by tools/derive_whipple.py: do not edit.

The arguments `sr, cr, sb, cb, ss, cs` are the sines and cosines of roll, of beta = pitch - lam, and of steer; the
other names are explained in the script that wrote this file.
"""

# ruff: noqa: E501
# fmt: off
from __future__ import annotations

import math

from numba import njit

Constants = tuple[
    float, float, float, float, float, float, float, float, float, float, float,
    float, float, float, float, float, float, float, float, float, float, float,
]
"""CONSTANT_NAMES in this order, made by `bike_sim.physics.bicycle.whipple.constants`."""

CONSTANT_NAMES = ("rR", "rF", "d1", "fx", "fz", "g", "m1", "x1", "z1", "I1xx", "I1xz", "I1yy", "I1zz", "JR", "m2", "x2", "z2", "I2xx", "I2xz", "I2yy", "I2zz", "JF")


@njit(cache=True)
def motion(
    sr: float,
    cr: float,
    sb: float,
    cb: float,
    ss: float,
    cs: float,
    roll_rate: float,
    steer_rate: float,
    front_wheel_rate: float,
    torque: float,
    constants: Constants,
) -> tuple[float, float, float, float, float, float]:
    """Return (yaw rate, rear speed, pitch rate, roll, steer and front wheel acceleration), rad, m, s."""
    (rR, rF, d1, fx, fz, g, m1, x1, z1, I1xx, I1xz, I1yy, I1zz, JR, m2, x2, z2, I2xx, I2xz, I2yy, I2zz, JF) = constants
    e0 = cs*fx
    along = d1 + e0
    e1 = cb*ss
    nx = -e1
    e2 = cr*cs
    e3 = sr*ss
    ny = e2 - e3*sb
    e4 = nx**2 + ny**2
    inv_k = 1/math.sqrt(e4)
    e5 = cs*sr
    e6 = cr*sb
    e7 = e6*ss
    nz = e5 + e7
    e8 = inv_k*rF
    down = e8*nz
    e10 = fz*sb
    e9 = along*cb
    qx = down*nx + e10 + e9
    inv_qx = 1/qx
    e11 = 1/cr
    lever = e11*inv_qx
    e12 = cb*fz
    rise = along*sb - e12 - rR
    e13 = fx*ss
    qy = cr*e13 + down*ny + rise*sr
    pitch_roll = lever*qy
    yaw_roll = -pitch_roll*sr
    e14 = cb*cr
    axis_z = e14
    e15 = cb*d1
    bx = -e15 + qx
    e16 = -rR
    e17 = d1*sb
    head = -e16 - e17
    e18 = cr*head
    bz = -e18
    arm_y = axis_z*bx - bz*sb
    e19 = cb*sr
    axis_y = -e19
    by = head*sr + qy
    arm_z = -axis_y*bx + by*sb
    pitch_steer = arm_z*lever
    e20 = arm_y*inv_qx
    yaw_steer = -e20 - pitch_steer*sr
    turn = e8
    e21 = inv_qx*nx
    yaw_wheel = -e21*turn
    yaw_rate = front_wheel_rate*yaw_wheel + roll_rate*yaw_roll + steer_rate*yaw_steer
    speed_roll = pitch_roll*rR
    arm_x = axis_y*bz - axis_z*by
    speed_steer = -arm_x - e20*qy + pitch_steer*rR
    speed_wheel = ny*turn + qy*yaw_wheel
    rear_speed = front_wheel_rate*speed_wheel + roll_rate*speed_roll + speed_steer*steer_rate
    e22 = pitch_roll*roll_rate
    pitch_rate = e22 + pitch_steer*steer_rate
    w1_2_x = -e6*yaw_wheel
    w1_2_z = e14*yaw_wheel
    l1_2_x = I1xx*w1_2_x + I1xz*w1_2_z
    e23 = sr*yaw_wheel
    w1_2_y = e23
    l1_2_y = I1yy*w1_2_y
    l1_2_z = I1xz*w1_2_x + I1zz*w1_2_z
    w2_2_x = cs*w1_2_x + ss*w1_2_y
    l2_2_x = I2xx*w2_2_x + I2xz*w1_2_z
    w2_2_y = cs*w1_2_y - ss*w1_2_x
    l2_2_y = I2yy*w2_2_y
    l2_2_z = I2xz*w2_2_x + I2zz*w1_2_z
    hub_2 = e23*rR + speed_wheel
    vR_2_x = cb*hub_2
    v1_2_x = vR_2_x + w1_2_y*z1
    p1_2_x = m1*v1_2_x
    v1_2_y = -w1_2_x*z1 + w1_2_z*x1
    p1_2_y = m1*v1_2_y
    vR_2_z = hub_2*sb
    v1_2_z = vR_2_z - w1_2_y*x1
    p1_2_z = m1*v1_2_z
    vS_2_y = d1*w1_2_z
    v2_2_x = cs*vR_2_x + ss*vS_2_y + w2_2_y*z2
    p2_2_x = m2*v2_2_x
    v2_2_y = cs*vS_2_y - ss*vR_2_x + w1_2_z*x2 - w2_2_x*z2
    p2_2_y = m2*v2_2_y
    vS_2_z = -d1*w1_2_y + vR_2_z
    v2_2_z = vS_2_z - w2_2_y*x2
    p2_2_z = m2*v2_2_z
    e24 = 1/rR
    spin1_2 = e24*hub_2
    s1_2 = JR*spin1_2
    spin2_2 = w2_2_y + 1
    s2_2 = JF*spin2_2
    e25 = sr*yaw_roll
    hub_0 = e25*rR + speed_roll
    spin1_0 = e24*hub_0
    vR_0_x = cb*hub_0
    w1_0_y = e25 + pitch_roll
    v1_0_x = vR_0_x + w1_0_y*z1
    w1_0_x = cb - e6*yaw_roll
    w1_0_z = e14*yaw_roll + sb
    v1_0_y = -rR - w1_0_x*z1 + w1_0_z*x1
    vR_0_z = hub_0*sb
    v1_0_z = vR_0_z - w1_0_y*x1
    vS_0_y = d1*w1_0_z + e16
    w2_0_y = cs*w1_0_y - ss*w1_0_x
    v2_0_x = cs*vR_0_x + ss*vS_0_y + w2_0_y*z2
    w2_0_x = cs*w1_0_x + ss*w1_0_y
    v2_0_y = cs*vS_0_y - ss*vR_0_x + w1_0_z*x2 - w2_0_x*z2
    vS_0_z = -d1*w1_0_y + vR_0_z
    v2_0_z = vS_0_z - w2_0_y*x2
    M20 = l1_2_x*w1_0_x + l1_2_y*w1_0_y + l1_2_z*w1_0_z + l2_2_x*w2_0_x + l2_2_y*w2_0_y + l2_2_z*w1_0_z + p1_2_x*v1_0_x + p1_2_y*v1_0_y + p1_2_z*v1_0_z + p2_2_x*v2_0_x + p2_2_y*v2_0_y + p2_2_z*v2_0_z + s1_2*spin1_0 + s2_2*w2_0_y
    M22 = l1_2_x*w1_2_x + l1_2_y*w1_2_y + l1_2_z*w1_2_z + l2_2_x*w2_2_x + l2_2_y*w2_2_y + l2_2_z*w1_2_z + p1_2_x*v1_2_x + p1_2_y*v1_2_y + p1_2_z*v1_2_z + p2_2_x*v2_2_x + p2_2_y*v2_2_y + p2_2_z*v2_2_z + s1_2*spin1_2 + s2_2*spin2_2
    w1_1_x = -e6*yaw_steer
    w1_1_z = e14*yaw_steer
    l1_1_x = I1xx*w1_1_x + I1xz*w1_1_z
    e26 = sr*yaw_steer
    w1_1_y = e26 + pitch_steer
    l1_1_y = I1yy*w1_1_y
    l1_1_z = I1xz*w1_1_x + I1zz*w1_1_z
    w2_1_x = cs*w1_1_x + ss*w1_1_y
    w2_1_z = w1_1_z + 1
    l2_1_x = I2xx*w2_1_x + I2xz*w2_1_z
    w2_1_y = cs*w1_1_y - ss*w1_1_x
    l2_1_y = I2yy*w2_1_y
    l2_1_z = I2xz*w2_1_x + I2zz*w2_1_z
    hub_1 = e26*rR + speed_steer
    vR_1_x = cb*hub_1
    v1_1_x = vR_1_x + w1_1_y*z1
    p1_1_x = m1*v1_1_x
    v1_1_y = -w1_1_x*z1 + w1_1_z*x1
    p1_1_y = m1*v1_1_y
    vR_1_z = hub_1*sb
    v1_1_z = vR_1_z - w1_1_y*x1
    p1_1_z = m1*v1_1_z
    vS_1_y = d1*w1_1_z
    v2_1_x = cs*vR_1_x + ss*vS_1_y + w2_1_y*z2
    p2_1_x = m2*v2_1_x
    v2_1_y = cs*vS_1_y - ss*vR_1_x - w2_1_x*z2 + w2_1_z*x2
    p2_1_y = m2*v2_1_y
    vS_1_z = -d1*w1_1_y + vR_1_z
    v2_1_z = vS_1_z - w2_1_y*x2
    p2_1_z = m2*v2_1_z
    spin1_1 = e24*hub_1
    s1_1 = JR*spin1_1
    s2_1 = JF*w2_1_y
    M10 = l1_1_x*w1_0_x + l1_1_y*w1_0_y + l1_1_z*w1_0_z + l2_1_x*w2_0_x + l2_1_y*w2_0_y + l2_1_z*w1_0_z + p1_1_x*v1_0_x + p1_1_y*v1_0_y + p1_1_z*v1_0_z + p2_1_x*v2_0_x + p2_1_y*v2_0_y + p2_1_z*v2_0_z + s1_1*spin1_0 + s2_1*w2_0_y
    M11 = l1_1_x*w1_1_x + l1_1_y*w1_1_y + l1_1_z*w1_1_z + l2_1_x*w2_1_x + l2_1_y*w2_1_y + l2_1_z*w2_1_z + p1_1_x*v1_1_x + p1_1_y*v1_1_y + p1_1_z*v1_1_z + p2_1_x*v2_1_x + p2_1_y*v2_1_y + p2_1_z*v2_1_z + s1_1*spin1_1 + s2_1*w2_1_y
    l1_0_x = I1xx*w1_0_x + I1xz*w1_0_z
    l1_0_y = I1yy*w1_0_y
    l1_0_z = I1xz*w1_0_x + I1zz*w1_0_z
    l2_0_x = I2xx*w2_0_x + I2xz*w1_0_z
    l2_0_y = I2yy*w2_0_y
    l2_0_z = I2xz*w2_0_x + I2zz*w1_0_z
    p1_0_x = m1*v1_0_x
    p1_0_y = m1*v1_0_y
    p1_0_z = m1*v1_0_z
    p2_0_x = m2*v2_0_x
    p2_0_y = m2*v2_0_y
    p2_0_z = m2*v2_0_z
    s1_0 = JR*spin1_0
    s2_0 = JF*w2_0_y
    M00 = l1_0_x*w1_0_x + l1_0_y*w1_0_y + l1_0_z*w1_0_z + l2_0_x*w2_0_x + l2_0_y*w2_0_y + l2_0_z*w1_0_z + p1_0_x*v1_0_x + p1_0_y*v1_0_y + p1_0_z*v1_0_z + p2_0_x*v2_0_x + p2_0_y*v2_0_y + p2_0_z*v2_0_z + s1_0*spin1_0 + s2_0*w2_0_y
    inv0 = 1/M00
    l10 = M10*inv0
    inv1 = 1/(-M10*l10 + M11)
    l20 = M20*inv0
    M21 = l1_2_x*w1_1_x + l1_2_y*w1_1_y + l1_2_z*w1_1_z + l2_2_x*w2_1_x + l2_2_y*w2_1_y + l2_2_z*w2_1_z + p1_2_x*v1_1_x + p1_2_y*v1_1_y + p1_2_z*v1_1_z + p2_2_x*v2_1_x + p2_2_y*v2_1_y + p2_2_z*v2_1_z + s1_2*spin1_1 + s2_2*w2_1_y
    l21 = inv1*(-M10*l20 + M21)
    inv2 = 1/(-M20*l20 + M22 - l21**2/inv1)
    up1_x = -e6
    e27 = sr*yaw_rate
    hub = e27*rR + rear_speed
    along_dot = -e13*steer_rate
    nx_dot = -cb*cs*steer_rate + pitch_rate*sb*ss
    e28 = cr*steer_rate
    e29 = e1*pitch_rate
    e30 = sb*steer_rate
    ny_dot = -e28*ss - e29*sr - e30*e5 - e5*roll_rate - e7*roll_rate
    e31 = e4**(-3/2)
    inv_k_dot = -e31*nx*nx_dot - e31*ny*ny_dot
    e32 = roll_rate*sb
    nz_dot = cr*e29 + e2*e30 + e2*roll_rate - e3*e32 - e3*steer_rate
    e33 = inv_k_dot*rF
    down_dot = e33*nz + e8*nz_dot
    qx_dot = -along*pitch_rate*sb + along_dot*cb + down*nx_dot + down_dot*nx + e12*pitch_rate
    inv_qx_dot = -qx_dot/qx**2
    lever_dot = e11*inv_qx_dot + inv_qx*roll_rate*sr/cr**2
    rise_dot = along_dot*sb + e10*pitch_rate + e9*pitch_rate
    e34 = cr*roll_rate
    qy_dot = down*ny_dot + down_dot*ny + e0*e28 - e3*fx*roll_rate + e34*rise + rise_dot*sr
    pitch_roll_dot = lever*qy_dot + lever_dot*qy
    speed_roll_dot = pitch_roll_dot*rR
    axis_y_dot = -e14*roll_rate + pitch_rate*sb*sr
    e35 = e19*roll_rate
    e36 = e6*pitch_rate
    axis_z_dot = -e35 - e36
    head_dot = -e15*pitch_rate
    by_dot = e18*roll_rate + head_dot*sr + qy_dot
    bz_dot = -cr*head_dot + head*roll_rate*sr
    arm_x_dot = axis_y*bz_dot + axis_y_dot*bz - axis_z*by_dot - axis_z_dot*by
    bx_dot = e17*pitch_rate + qx_dot
    arm_y_dot = axis_z*bx_dot + axis_z_dot*bx - bz*cb*pitch_rate - bz_dot*sb
    arm_z_dot = -axis_y*bx_dot - axis_y_dot*bx + by*cb*pitch_rate + by_dot*sb
    pitch_steer_dot = arm_z*lever_dot + arm_z_dot*lever
    e37 = arm_y*inv_qx_dot
    e38 = arm_y_dot*inv_qx
    speed_steer_dot = -arm_x_dot - e20*qy_dot - e37*qy - e38*qy + pitch_steer_dot*rR
    turn_dot = e33
    yaw_wheel_dot = -e21*turn_dot - inv_qx*nx_dot*turn - inv_qx_dot*nx*turn
    speed_wheel_dot = ny*turn_dot + ny_dot*turn + qy*yaw_wheel_dot + qy_dot*yaw_wheel
    rear_speed_dot = front_wheel_rate*speed_wheel_dot + roll_rate*speed_roll_dot + speed_steer_dot*steer_rate
    yaw_roll_dot = -cr*e22 - pitch_roll_dot*sr
    yaw_steer_dot = -e34*pitch_steer - e37 - e38 - pitch_steer_dot*sr
    yaw_rate_dot = front_wheel_rate*yaw_wheel_dot + roll_rate*yaw_roll_dot + steer_rate*yaw_steer_dot
    e39 = sr*yaw_rate_dot
    e40 = rR*roll_rate
    hub_dot = cr*e40*yaw_rate + e39*rR + rear_speed_dot
    e41 = hub*sb
    vR_x_dot = cb*hub_dot - e41*pitch_rate
    pitch_rate_dot = pitch_roll_dot*roll_rate + pitch_steer_dot*steer_rate
    w1_y_dot = e34*yaw_rate + e39 + pitch_rate_dot
    v1_x_dot = vR_x_dot + w1_y_dot*z1
    vR_y = -e40
    e42 = cb*roll_rate
    w1_x = e42 - e6*yaw_rate
    e43 = e14*yaw_rate
    w1_z = e32 + e43
    v1_y = vR_y - w1_x*z1 + w1_z*x1
    vR_z = e41
    w1_y = e27 + pitch_rate
    v1_z = vR_z - w1_y*x1
    f1_x = m1*(g*up1_x + v1_x_dot - v1_y*w1_z + v1_z*w1_y)
    e44 = cb*hub
    vR_x = e44
    v1_x = vR_x + w1_y*z1
    w1_x_dot = -e32*pitch_rate - e43*pitch_rate - e6*yaw_rate_dot + roll_rate*sb*sr*yaw_rate
    w1_z_dot = e14*yaw_rate_dot - e35*yaw_rate - e36*yaw_rate + e42*pitch_rate
    v1_y_dot = -w1_x_dot*z1 + w1_z_dot*x1
    f1_y = m1*(g*sr + v1_x*w1_z + v1_y_dot - v1_z*w1_x)
    up1_z = e14
    vR_z_dot = e44*pitch_rate + hub_dot*sb
    v1_z_dot = vR_z_dot - w1_y_dot*x1
    e45 = g*up1_z
    f1_z = m1*(e45 - v1_x*w1_y + v1_y*w1_x + v1_z_dot)
    up2_x = cs*up1_x + e3
    vS_y = d1*w1_z + vR_y
    vS_y_dot = d1*w1_z_dot
    e46 = cs*w1_x
    e47 = ss*w1_y
    w2_y_dot = cs*w1_y_dot - e46*steer_rate - e47*steer_rate - ss*w1_x_dot
    e48 = cs*vS_y
    e49 = ss*vR_x
    v2_x_dot = cs*vR_x_dot + e48*steer_rate - e49*steer_rate + ss*vS_y_dot + w2_y_dot*z2
    w2_x = e46 + e47
    w2_z = steer_rate + w1_z
    v2_y = e48 - e49 - w2_x*z2 + w2_z*x2
    vS_z = -d1*w1_y + vR_z
    e50 = cs*w1_y
    e51 = ss*w1_x
    w2_y = e50 - e51
    v2_z = vS_z - w2_y*x2
    f2_x = m2*(g*up2_x + v2_x_dot - v2_y*w2_z + v2_z*w2_y)
    up2_y = e5 - ss*up1_x
    e52 = cs*vR_x
    e53 = ss*vS_y
    v2_x = e52 + e53 + w2_y*z2
    w2_x_dot = cs*w1_x_dot + e50*steer_rate - e51*steer_rate + ss*w1_y_dot
    v2_y_dot = cs*vS_y_dot - e52*steer_rate - e53*steer_rate - ss*vR_x_dot + w1_z_dot*x2 - w2_x_dot*z2
    f2_y = m2*(g*up2_y + v2_x*w2_z + v2_y_dot - v2_z*w2_x)
    vS_z_dot = -d1*w1_y_dot + vR_z_dot
    v2_z_dot = vS_z_dot - w2_y_dot*x2
    f2_z = m2*(e45 - v2_x*w2_y + v2_y*w2_x + v2_z_dot)
    spin1_dot = e24*hub_dot
    k1 = JR*spin1_dot
    k2 = JF*w2_y_dot
    spin1 = e24*hub
    h1_y = I1yy*w1_y + JR*spin1
    h1_z = I1xz*w1_x + I1zz*w1_z
    t1_x = I1xx*w1_x_dot + I1xz*w1_z_dot - h1_y*w1_z + h1_z*w1_y
    h1_x = I1xx*w1_x + I1xz*w1_z
    t1_y = I1yy*w1_y_dot + h1_x*w1_z - h1_z*w1_x
    t1_z = I1xz*w1_x_dot + I1zz*w1_z_dot - h1_x*w1_y + h1_y*w1_x
    spin2 = front_wheel_rate + w2_y
    h2_y = I2yy*w2_y + JF*spin2
    h2_z = I2xz*w2_x + I2zz*w2_z
    t2_x = I2xx*w2_x_dot + I2xz*w1_z_dot - h2_y*w2_z + h2_z*w2_y
    h2_x = I2xx*w2_x + I2xz*w2_z
    t2_y = I2yy*w2_y_dot + h2_x*w2_z - h2_z*w2_x
    t2_z = I2xz*w2_x_dot + I2zz*w1_z_dot - h2_x*w2_y + h2_y*w2_x
    r0 = -f1_x*v1_0_x - f1_y*v1_0_y - f1_z*v1_0_z - f2_x*v2_0_x - f2_y*v2_0_y - f2_z*v2_0_z - k1*spin1_0 - k2*w2_0_y - t1_x*w1_0_x - t1_y*w1_0_y - t1_z*w1_0_z - t2_x*w2_0_x - t2_y*w2_0_y - t2_z*w1_0_z
    r2 = -f1_x*v1_2_x - f1_y*v1_2_y - f1_z*v1_2_z - f2_x*v2_2_x - f2_y*v2_2_y - f2_z*v2_2_z - k1*spin1_2 - k2*spin2_2 - t1_x*w1_2_x - t1_y*w1_2_y - t1_z*w1_2_z - t2_x*w2_2_x - t2_y*w2_2_y - t2_z*w1_2_z
    r1 = -f1_x*v1_1_x - f1_y*v1_1_y - f1_z*v1_1_z - f2_x*v2_1_x - f2_y*v2_1_y - f2_z*v2_1_z - k1*spin1_1 - k2*w2_1_y - t1_x*w1_1_x - t1_y*w1_1_y - t1_z*w1_1_z - t2_x*w2_1_x - t2_y*w2_1_y - t2_z*w2_1_z + torque
    y1 = -l10*r0 + r1
    front_wheel_acc = inv2*(-l20*r0 - l21*y1 + r2)
    steer_acc = -front_wheel_acc*l21 + inv1*y1
    roll_acc = -front_wheel_acc*l20 + inv0*r0 - l10*steer_acc
    return yaw_rate, rear_speed, pitch_rate, roll_acc, steer_acc, front_wheel_acc


@njit(cache=True)
def energies(
    sr: float,
    cr: float,
    sb: float,
    cb: float,
    ss: float,
    cs: float,
    roll_rate: float,
    steer_rate: float,
    front_wheel_rate: float,
    constants: Constants,
) -> tuple[float, float]:
    """Return (kinetic energy, potential energy above the ground), J."""
    (rR, rF, d1, fx, fz, g, m1, x1, z1, I1xx, I1xz, I1yy, I1zz, JR, m2, x2, z2, I2xx, I2xz, I2yy, I2zz, JF) = constants
    along = cs*fx + d1
    nx = -cb*ss
    e0 = sr*ss
    ny = cr*cs - e0*sb
    inv_k = 1/math.sqrt(nx**2 + ny**2)
    e1 = cr*sb
    nz = cs*sr + e1*ss
    e2 = inv_k*rF
    down = e2*nz
    qx = along*cb + down*nx + fz*sb
    inv_qx = 1/qx
    lever = inv_qx/cr
    rise = along*sb - cb*fz - rR
    qy = cr*fx*ss + down*ny + rise*sr
    pitch_roll = lever*qy
    speed_roll = pitch_roll*rR
    axis_y = -cb*sr
    e3 = cb*cr
    axis_z = e3
    head = -d1*sb + rR
    by = head*sr + qy
    bz = -cr*head
    arm_x = axis_y*bz - axis_z*by
    bx = -cb*d1 + qx
    arm_y = axis_z*bx - bz*sb
    arm_z = -axis_y*bx + by*sb
    pitch_steer = arm_z*lever
    e4 = arm_y*inv_qx
    speed_steer = -arm_x - e4*qy + pitch_steer*rR
    turn = e2
    yaw_wheel = -inv_qx*nx*turn
    speed_wheel = ny*turn + qy*yaw_wheel
    rear_speed = front_wheel_rate*speed_wheel + roll_rate*speed_roll + speed_steer*steer_rate
    yaw_roll = -pitch_roll*sr
    yaw_steer = -e4 - pitch_steer*sr
    yaw_rate = front_wheel_rate*yaw_wheel + roll_rate*yaw_roll + steer_rate*yaw_steer
    e5 = sr*yaw_rate
    hub = e5*rR + rear_speed
    spin1 = hub/rR
    w1_x = cb*roll_rate - e1*yaw_rate
    pitch_rate = pitch_roll*roll_rate + pitch_steer*steer_rate
    w1_y = e5 + pitch_rate
    w2_y = cs*w1_y - ss*w1_x
    spin2 = front_wheel_rate + w2_y
    vR_x = cb*hub
    v1_x = vR_x + w1_y*z1
    vR_y = -rR*roll_rate
    w1_z = e3*yaw_rate + roll_rate*sb
    v1_y = vR_y - w1_x*z1 + w1_z*x1
    vR_z = hub*sb
    v1_z = vR_z - w1_y*x1
    vS_y = d1*w1_z + vR_y
    v2_x = cs*vR_x + ss*vS_y + w2_y*z2
    w2_x = cs*w1_x + ss*w1_y
    w2_z = steer_rate + w1_z
    v2_y = cs*vS_y - ss*vR_x - w2_x*z2 + w2_z*x2
    vS_z = -d1*w1_y + vR_z
    v2_z = vS_z - w2_y*x2
    kinetic = (1/2)*I1yy*w1_y**2 + (1/2)*I2yy*w2_y**2 + (1/2)*JF*spin2**2 + (1/2)*JR*spin1**2 + (1/2)*m1*(v1_x**2 + v1_y**2 + v1_z**2) + (1/2)*m2*(v2_x**2 + v2_y**2 + v2_z**2) + (1/2)*w1_x*(I1xx*w1_x + I1xz*w1_z) + (1/2)*w1_z*(I1xz*w1_x + I1zz*w1_z) + (1/2)*w2_x*(I2xx*w2_x + I2xz*w2_z) + (1/2)*w2_z*(I2xz*w2_x + I2zz*w2_z)
    up1_x = -e1
    up1_z = e3
    up2_x = cs*up1_x + e0
    e6 = cr*rR
    potential = g*(m1*(e6 + up1_x*x1 + up1_z*z1) + m2*(d1*up1_x + e6 + up1_z*z2 + up2_x*x2))
    return kinetic, potential
