// The terms of the arm's model that a tick needs, by pinocchio, as multicontact_control has them.
#ifndef ARM_MODEL_HPP
#define ARM_MODEL_HPP

#include <pinocchio/multibody/data.hpp>
#include <pinocchio/multibody/model.hpp>
#include <pinocchio/algorithm/compute-all-terms.hpp>
#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/serialization/model.hpp>

#include <string>

#include "multicontact_tick.h"

class ArmModel {
public:
    // `path` is that of model.txt, which pinocchio of the version that has written it reads.
    explicit ArmModel(const std::string &path) : model_(load(path)), data_(model_),
        frame_(model_.getFrameId(MC_OPERATIONAL_FRAME, pinocchio::BODY)),
        sensor_(model_.getFrameId(MC_SENSOR_FRAME, pinocchio::BODY)) {}

    // Compute the terms at `motion` of a controller. It allocates nothing.
    void compute(mc_controller &controller)
    {
        using Joints = Eigen::Matrix<double, MC_JOINTS, 1>;
        using ByColumns = Eigen::Matrix<double, MC_JOINTS, MC_JOINTS>;
        using ByRows = Eigen::Matrix<double, 6, MC_JOINTS, Eigen::RowMajor>;

        q_ = Eigen::Map<const Joints>(controller.motion[0]);
        v_ = Eigen::Map<const Joints>(controller.motion[1]);
        pinocchio::computeAllTerms(model_, data_, q_, v_);
        pinocchio::updateFramePlacements(model_, data_);
        jacobian_.setZero();
        jacobian_rate_.setZero();
        const auto axes = pinocchio::LOCAL_WORLD_ALIGNED;
        pinocchio::getFrameJacobian(model_, data_, frame_, axes, jacobian_);
        pinocchio::getFrameJacobianTimeVariation(model_, data_, frame_, axes, jacobian_rate_);

        auto &terms = controller.terms;
        Eigen::Map<ByColumns>(&terms.mass_matrix[0][0]) = data_.M;
        Eigen::Map<Joints>(terms.bias_torque) = data_.nle;
        Eigen::Map<Joints>(terms.gravity) = data_.g;
        Eigen::Map<ByRows>(&terms.jacobian[0][0]) = jacobian_;
        Eigen::Map<ByRows>(&terms.jacobian_rate[0][0]) = jacobian_rate_;
        place(data_.oMf[frame_], terms.position, terms.rotation);
        place(data_.oMf[sensor_], terms.sensor_position, terms.sensor_rotation);
        if (MC_ADDS_GRAVITY) {
            Eigen::Map<Joints>(controller.added) = added_torque();
        }
    }

private:
    // What drives that carry the arm add to a command; of the tool's weight they need not know.
    const Eigen::VectorXd &added_torque()
    {
        added_ = data_.g;
        if (!MC_ADDS_TOOL_GRAVITY) {
            const double com[3] = MC_TOOL_COM;
            const Eigen::Vector3d weight = MC_TOOL_MASS * model_.gravity.linear();
            const Eigen::Vector3d lever =
                data_.oMf[sensor_].rotation() * Eigen::Map<const Eigen::Vector3d>(com);
            jacobian_.setZero();
            pinocchio::getFrameJacobian(
                model_, data_, sensor_, pinocchio::LOCAL_WORLD_ALIGNED, jacobian_);
            Eigen::Matrix<double, 6, 1> wrench;
            wrench << weight, lever.cross(weight);
            added_.noalias() += jacobian_.transpose() * wrench;
        }
        return added_;
    }

    static pinocchio::Model load(const std::string &path)
    {
        pinocchio::Model model;
        model.loadFromText(path);
        return model;
    }

    static void place(const pinocchio::SE3 &frame, double position[3], double rotation[3][3])
    {
        Eigen::Map<Eigen::Vector3d> origin(position);
        Eigen::Map<Eigen::Matrix3d> axes(&rotation[0][0]);
        origin = frame.translation();
        axes = frame.rotation();
    }

    pinocchio::Model model_;
    pinocchio::Data data_;
    pinocchio::FrameIndex frame_;
    pinocchio::FrameIndex sensor_;
    Eigen::VectorXd q_ = Eigen::VectorXd::Zero(MC_JOINTS);
    Eigen::VectorXd v_ = Eigen::VectorXd::Zero(MC_JOINTS);
    Eigen::VectorXd added_ = Eigen::VectorXd::Zero(MC_JOINTS);
    pinocchio::Data::Matrix6x jacobian_ = pinocchio::Data::Matrix6x::Zero(6, MC_JOINTS);
    pinocchio::Data::Matrix6x jacobian_rate_ = pinocchio::Data::Matrix6x::Zero(6, MC_JOINTS);
};

#endif
