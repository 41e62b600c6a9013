// An action model of crocoddyl that asks compiled kernels for its values and derivatives, and a C interface to its solver.
//
// The kernels are those of stage_kernels.py, given as pointers; what they read besides (x, w) is theirs alone, behind
// `table`. Matrices of the kernels are by rows: fz (6, 8) and lzz (8, 8) by (x, w), lz (8).

#include <cstdint>
#include <memory>
#include <vector>

#include "crocoddyl/core/action-base.hpp"
#include "crocoddyl/core/optctrl/shooting.hpp"
#include "crocoddyl/core/solvers/box-fddp.hpp"
#include "crocoddyl/core/states/euclidean.hpp"

namespace {

constexpr int kStates = 6, kControls = 2, kBoth = kStates + kControls;
using Value = double (*)(const int64_t* table, int64_t k, const double* x, const double* w, double* next);
using Slopes = void (*)(const int64_t* table, int64_t k, const double* x, const double* w, double* fz, double* lz,
                        double* lzz);
using Base = crocoddyl::ActionModelAbstractTpl<double>;
using Data = std::shared_ptr<crocoddyl::ActionDataAbstractTpl<double>>;
using Vector = Eigen::VectorXd;
using ByRows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

class Stage : public Base {
 public:
  Stage(std::shared_ptr<crocoddyl::StateAbstractTpl<double>> state, Value value, Slopes slopes, const int64_t* table,
        int64_t k, bool idle, const double* low, const double* high)
      : Base(state, kControls, 1), value_(value), slopes_(slopes), table_(table), k_(k), idle_(idle) {
    set_u_lb(Eigen::Map<const Vector>(low, kControls));
    set_u_ub(Eigen::Map<const Vector>(high, kControls));
  }

  void calc(const Data& data, const Eigen::Ref<const Vector>& x, const Eigen::Ref<const Vector>& w) override {
    data->cost = value_(table_, k_, x.data(), w.data(), data->xnext.data());
    if (idle_) data->cost += 0.5 * w[1] * w[1];
  }

  void calc(const Data& data, const Eigen::Ref<const Vector>& x) override {
    const double none[kControls] = {};
    data->cost = value_(table_, k_, x.data(), none, data->xnext.data());
    data->xnext = x;
  }

  void calcDiff(const Data& data, const Eigen::Ref<const Vector>& x, const Eigen::Ref<const Vector>& w) override {
    derive(data, x, w.data());
    data->Fx = Eigen::Map<const ByRows>(fz_, kStates, kBoth).leftCols(kStates);
    data->Fu = Eigen::Map<const ByRows>(fz_, kStates, kBoth).rightCols(kControls);
    data->Lu = Eigen::Map<const Vector>(lz_ + kStates, kControls);
    data->Luu = Eigen::Map<const ByRows>(lzz_, kBoth, kBoth).bottomRightCorner(kControls, kControls);
    data->Lxu = Eigen::Map<const ByRows>(lzz_, kBoth, kBoth).topRightCorner(kStates, kControls);
    if (idle_) data->Lu[1] += w[1], data->Luu(1, 1) += 1.0;
  }

  void calcDiff(const Data& data, const Eigen::Ref<const Vector>& x) override {
    const double none[kControls] = {};
    derive(data, x, none);
  }

  // Casts to other scalars are part of the interface; the kernels know doubles alone.
  std::shared_ptr<crocoddyl::ActionModelBase> cloneAsDouble() const override { return std::make_shared<Stage>(*this); }
  std::shared_ptr<crocoddyl::ActionModelBase> cloneAsFloat() const override { return nullptr; }

 private:
  void derive(const Data& data, const Eigen::Ref<const Vector>& x, const double* w) {
    slopes_(table_, k_, x.data(), w, fz_, lz_, lzz_);
    data->Lx = Eigen::Map<const Vector>(lz_, kStates);
    data->Lxx = Eigen::Map<const ByRows>(lzz_, kBoth, kBoth).topLeftCorner(kStates, kStates);
  }

  Value value_;
  Slopes slopes_;
  const int64_t* table_;
  int64_t k_;
  bool idle_;  // the second control does nothing here: half its square is its cost
  double fz_[kStates * kBoth] = {}, lz_[kBoth] = {}, lzz_[kBoth * kBoth] = {};
};

using Shooting = crocoddyl::ShootingProblemTpl<double>;

}  // namespace

extern "C" {

// At each of `count` stages whether the second control is idle, and bounds of w: low and high, (count, 2) each. The table
// is read again at every call.
void* shooting_new(Value value, Slopes slopes, const int64_t* table, int64_t count, const double* x0,
                   const int64_t* idle, const double* low, const double* high) {
  auto state = std::make_shared<crocoddyl::StateVectorTpl<double>>(kStates);
  std::vector<std::shared_ptr<Base>> stages;
  for (int64_t k = 0; k < count; ++k)
    stages.push_back(std::make_shared<Stage>(state, value, slopes, table, k, idle[k] != 0, low + k * kControls,
                                             high + k * kControls));
  auto last = std::make_shared<Stage>(state, value, slopes, table, count, true, low, high);
  auto shooting = std::make_shared<Shooting>(Eigen::Map<const Vector>(x0, kStates), stages, last);
  shooting->set_nthreads(1);
  return new std::shared_ptr<Shooting>(shooting);
}

// From states (count + 1, 6) and controls (count, 2), which are replaced; iterations, and its stopping value to `stop`.
int64_t shooting_solve(void* handle, double* states, double* controls, double tolerance, int64_t iterations,
                       double regularisation, double* stop) {
  auto shooting = *static_cast<std::shared_ptr<Shooting>*>(handle);
  const auto& stages = shooting->get_runningModels();
  std::vector<Vector> xs, us;
  for (std::size_t k = 0; k <= stages.size(); ++k)
    xs.emplace_back(Eigen::Map<const Vector>(states + k * kStates, kStates));
  for (std::size_t k = 0; k < stages.size(); ++k)
    us.emplace_back(Eigen::Map<const Vector>(controls + k * kControls, kControls));
  crocoddyl::SolverBoxFDDP solver(shooting);
  solver.set_th_stop(tolerance);
  solver.solve(xs, us, static_cast<std::size_t>(iterations), false, regularisation);
  for (std::size_t k = 0; k <= stages.size(); ++k)
    Eigen::Map<Vector>(states + k * kStates, kStates) = solver.get_xs()[k];
  for (std::size_t k = 0; k < stages.size(); ++k)
    Eigen::Map<Vector>(controls + k * kControls, kControls) = solver.get_us()[k];
  *stop = solver.get_stop();
  return static_cast<int64_t>(solver.get_iter());
}

void shooting_drop(void* handle) { delete static_cast<std::shared_ptr<Shooting>*>(handle); }
}
