// A control loop around the tick: samples come over UDP, and torques go back.
//
//   control_loop FOLDER PORT FORCE [PRIORITY]
//
// FOLDER is that of the export. The arm stays where its first sample finds it, and presses with
// FORCE [N] on every surface. With a PRIORITY the loop asks for SCHED_RR, and locks its memory. An
// empty message ends it; it prints how long its cycles took.
#include <arpa/inet.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "arm_model.hpp"
#include "multicontact_tick.h"

namespace {

// What the sensors read at a time; the wrench in the sensor's frame, of the arm on its tool.
struct Sample {
    double time;  // [s]
    double q[MC_JOINTS];  // [rad]
    double velocity[MC_JOINTS];  // [rad/s]
    double effort[MC_JOINTS];  // torques that acted in the period before [N m]
    double wrench[6];  // [N, N m]
};

struct Command {
    double time;  // of the sample that it answers [s]
    double torque[MC_JOINTS];  // [N m]
};

mc_controller controller;  // static: it is too large for some stacks

bool configure(const std::string &path)
{
    std::ifstream file(path, std::ios::binary);
    const std::vector<char> content{std::istreambuf_iterator<char>(file), {}};
    const int refused = mc_configure(&controller, content.data(), content.size());
    if (refused) {
        std::fprintf(stderr, "%s: refused (%d)\n", path.c_str(), refused);
    }
    return !refused;
}

bool become_real_time(int priority)
{
    const sched_param parameters{priority};
    if (sched_setscheduler(0, SCHED_RR, &parameters) || mlockall(MCL_CURRENT | MCL_FUTURE)) {
        std::perror("real time");
        return false;
    }
    return true;
}

void take(const Sample &sample)
{
    mc_input &in = controller.stages[0].sample;
    in.time = in.joints_stamp = in.wrench_stamp = sample.time;
    in.joints_came = in.velocity_came = in.effort_came = in.wrench_came = MC_FINE;
    in.variance_came = MC_ABSENT;  // R stays as configured
    std::copy_n(sample.q, MC_JOINTS, in.q);
    std::copy_n(sample.velocity, MC_JOINTS, in.velocity);
    std::copy_n(sample.effort, MC_JOINTS, in.effort);
    std::copy_n(sample.wrench, 6, in.wrench);
    in.command_came = MC_COMMAND_DELAY >= 0 && controller.gates[0].begun;
    for (int j = 0; j < MC_JOINTS; ++j) {
        in.command[j] = controller.joints[j].gate.commanded_torque;
    }
    if (MC_WRENCH_BY_MOMENTUM) {
        const mc_input_stage &stage = controller.stages[0];
        const bool found = stage.state.unknown <= stage.settings.commands + 1;
        in.wrench_came = found ? MC_FINE : MC_ABSENT;
        std::copy_n(controller.controls[0].wrench, 6, in.wrench);
    }
    mc_take(&controller);
}

// The pose is that in which the task has begun; couples stay 0.
void press(double force)
{
    const mc_task_limits &limits = controller.limits[0];
    if (!controller.supervisions[0].started || limits.held || limits.locked) {
        return;
    }
    for (mc_contact &contact : controller.contacts) {
        contact.wanted = contact.config.kind == MC_FORCE;
        contact.alpha_wanted = contact.wanted ? force : 0.0;
    }
}

}  // namespace

int main(int count, char **arguments)
{
    if (count < 4) {
        std::fprintf(stderr, "usage: control_loop FOLDER PORT FORCE [PRIORITY]\n");
        return 2;
    }
    const std::string folder = arguments[1];
    if (!configure(folder + "/multicontact_records.bin")) {
        return 2;
    }
    ArmModel model(folder + "/model.txt");
    const double force = std::atof(arguments[3]);

    const int link = socket(AF_INET, SOCK_DGRAM, 0);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<uint16_t>(std::atoi(arguments[2])));
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (bind(link, reinterpret_cast<sockaddr *>(&address), sizeof address)) {
        std::perror("port");
        return 2;
    }
    if (count > 4 && !become_real_time(std::atoi(arguments[4]))) {
        return 2;
    }
    std::printf("ready\n");
    std::fflush(stdout);

    using Clock = std::chrono::steady_clock;
    Clock::duration worst{0};
    long cycles = 0;
    long answers[MC_TO_SAFE + 1] = {};  // by what has given them
    Sample sample;
    Command command;
    sockaddr_in peer{};
    for (;; ++cycles) {
        socklen_t length = sizeof peer;
        const ssize_t size = recvfrom(
            link, &sample, sizeof sample, 0, reinterpret_cast<sockaddr *>(&peer), &length);
        if (size != sizeof sample) {
            break;
        }
        const auto begin = Clock::now();
        take(sample);
        model.compute(controller);
        press(force);
        mc_tick(&controller);
        ++answers[controller.supervisions[0].reaction];
        command.time = sample.time;
        for (int j = 0; j < MC_JOINTS; ++j) {
            const mc_joint &joint = controller.joints[j];
            command.torque[j] = joint.gate.commanded_torque - joint.drive_gravity_torque;
        }
        worst = std::max(worst, Clock::now() - begin);
        sendto(link, &command, sizeof command, 0, reinterpret_cast<sockaddr *>(&peer), length);
    }
    const auto nanoseconds = std::chrono::duration_cast<std::chrono::nanoseconds>(worst);
    std::printf("%ld cycles, longest %.1f us, %ld held, %ld floating, %ld damped\n", cycles,
        1e-3 * static_cast<double>(nanoseconds.count()), answers[MC_TO_HOLD],
        answers[MC_TO_FLOAT], answers[MC_TO_DAMP]);
    return 0;
}
