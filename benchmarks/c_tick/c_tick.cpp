// How long a tick takes in C, with and without pinocchio, on the recorded inputs of a run.
//
//   c_tick FOLDER INPUTS TICKS
//
// The first lap compares: each torque with that of Python, each term of the model with the one that
// Python had. The last line is a JSON object.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "arm_model.hpp"
#include "multicontact_tick.h"

namespace {

// What a tick of Python was given, and its answer.
struct Tick {
    mc_input sample;
    mc_task wanted;
    double alpha_wanted[MC_COLUMNS];
    bool contact_wanted[MC_COLUMNS];
    mc_terms terms;
    double torque[MC_JOINTS];
};

mc_controller controller;

std::vector<char> read(const std::string &path)
{
    std::ifstream file(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(file), {}};
}

void enter(const Tick &tick)
{
    controller.stages[0].sample = tick.sample;
    controller.controls[0].wanted = tick.wanted;
    for (int i = 0; i < MC_COLUMNS; ++i) {
        controller.contacts[i].wanted = tick.contact_wanted[i];
        controller.contacts[i].alpha_wanted = tick.alpha_wanted[i];
    }
}

bool same(const double *found, const double *expected, std::size_t count)
{
    return std::memcmp(found, expected, count * sizeof(double)) == 0;
}

// Of M pinocchio fills in the upper triangle alone.
bool same_terms(const mc_terms &found, const mc_terms &expected)
{
    mc_terms upper = found;
    for (int row = 0; row < MC_JOINTS; ++row) {
        for (int column = 0; column < row; ++column) {
            upper.mass_matrix[column][row] = expected.mass_matrix[column][row];
        }
    }
    return std::memcmp(&upper, &expected, sizeof upper) == 0;
}

void print_times(const char *name, std::vector<double> &times)
{
    std::sort(times.begin(), times.end());
    const auto share = [&](double part) {
        return times[static_cast<std::size_t>(part * static_cast<double>(times.size() - 1))];
    };
    std::printf("\"%s\": {\"p50\": %.3f, \"p99\": %.3f, \"p99.9\": %.3f, \"max\": %.3f}, ", name,
        share(0.5), share(0.99), share(0.999), times.back());
}

}  // namespace

int main(int count, char **arguments)
{
    if (count != 4) {
        return 2;
    }
    const std::string folder = arguments[1];
    const std::vector<char> records = read(folder + "/multicontact_records.bin");
    const std::vector<char> content = read(arguments[2]);
    std::vector<Tick> ticks(content.size() / sizeof(Tick));
    std::memcpy(ticks.data(), content.data(), ticks.size() * sizeof(Tick));
    if (ticks.empty() || mc_configure(&controller, records.data(), records.size())) {
        return 2;
    }
    ArmModel model(folder + "/model.txt");

    long unlike_torques = 0;
    long unlike_terms = 0;
    for (const Tick &tick : ticks) {
        enter(tick);
        mc_take(&controller);
        model.compute(controller);
        unlike_terms += !same_terms(controller.terms, tick.terms);
        mc_tick(&controller);
        for (int j = 0; j < MC_JOINTS; ++j) {
            const mc_joint &joint = controller.joints[j];
            const double torque = joint.gate.commanded_torque - joint.drive_gravity_torque;
            unlike_torques += !same(&torque, &tick.torque[j], 1);
        }
    }

    using Clock = std::chrono::steady_clock;
    using Microseconds = std::chrono::duration<double, std::micro>;
    std::printf("{");
    for (const bool with_model : {true, false}) {
        std::vector<double> times;
        const auto wanted = static_cast<std::size_t>(std::atol(arguments[3]));
        for (std::size_t i = 0; i < wanted; ++i) {
            const Tick &tick = ticks[i % ticks.size()];
            if (i % ticks.size() == 0) {
                mc_reset(&controller, records.data());
            }
            enter(tick);
            if (!with_model) {
                controller.terms = tick.terms;
            }
            const auto begin = Clock::now();
            mc_take(&controller);
            if (with_model) {
                model.compute(controller);
            }
            mc_tick(&controller);
            times.push_back(Microseconds(Clock::now() - begin).count());
        }
        print_times(with_model ? "with pinocchio" : "without", times);
    }
    std::printf("\"ticks\": %zu, \"unlike_torques\": %ld, \"unlike_terms\": %ld}\n", ticks.size(),
        unlike_torques, unlike_terms);
    return 0;
}
