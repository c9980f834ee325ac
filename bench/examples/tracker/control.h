/* The control law, free of bus and clock. SI units, ISO 8855 axes (x forward, y and angles positive to the left). */
#ifndef CONTROL_H
#define CONTROL_H

struct motion {
    double v_x;      /* longitudinal velocity (m/s) */
    double yaw_rate; /* rad/s */
};

struct command {
    double steering_angle; /* of the front wheels (rad) */
    double wheel_torque;   /* on each wheel, positive drives forward (N m) */
};

/* The command that brings a vehicle from `now` to `reference`. */
struct command control(struct motion now, struct motion reference);

#endif
