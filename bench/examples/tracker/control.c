/* See control.h. The steering angle of steady cornering with the linear single-track model, delta = (L / v_x + K v_x)
 * times the yaw rate (ISO 8855, understeer gradient K), plus proportional feedback; torques in proportion to the speed
 * error. */
#include "control.h"

#define WHEELBASE 3.0               /* L (m) */
#define UNDERSTEER 0.0027           /* K = M (l_r / (2 C_f) - l_f / (2 C_r)) / L (rad s^2 / m) */
#define LOWEST_SPEED 1.0            /* steering is as at this speed below it (m/s) */
#define YAW_RATE_GAIN 0.3           /* rad / (rad/s) */
#define SPEED_GAIN 646.13           /* about 5 1/s times mass and wheel radius, a quarter for each wheel (N s) */
#define LARGEST_STEERING_ANGLE 1.0  /* what the signal carries (rad) */
#define LARGEST_WHEEL_TORQUE 5000.0 /* what the signal carries (N m) */

static double limited(double value, double largest) { return value > largest ? largest : value < -largest ? -largest : value; }

struct command control(struct motion now, struct motion reference) {
    double v_x = now.v_x > LOWEST_SPEED ? now.v_x : LOWEST_SPEED;
    double steady = (WHEELBASE / v_x + UNDERSTEER * v_x) * reference.yaw_rate;
    return (struct command){
        .steering_angle = limited(steady + YAW_RATE_GAIN * (reference.yaw_rate - now.yaw_rate), LARGEST_STEERING_ANGLE),
        .wheel_torque = limited(SPEED_GAIN * (reference.v_x - now.v_x), LARGEST_WHEEL_TORQUE),
    };
}
