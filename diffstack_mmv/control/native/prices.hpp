// Costs of many plans of each problem, eight plans at a time, and their slopes by the numbers of the problem.
//
// The generated `Problem` has the sizes n, m, T, and the costs of its times.
#pragma once
#include "small.hpp"

namespace dmmv {

template <class P>
struct Plans {
  static constexpr int n = P::n, m = P::m, T = P::T;

  // where the plans of a problem stand: states (count, T + 1, n), controls (count, T + 1, m)
  const Real *states, *controls;
  long count;
  Real numbers[P::NUMBERS + 1], q[P::COST_NUMBERS + 1];
  Pack x[n], u[m];
  Pack slopes[P::COST_NUMBERS + 1], total[P::COST_NUMBERS + 1];

  void prepare(const Real* parameters, const Real* states_, const Real* controls_, long count_) {
    P::prelude(parameters, numbers);
    states = states_;
    controls = controls_;
    count = count_;
  }

  void at(int t) {
    for (int k = 0; k < P::COST_NUMBERS; ++k) q[k] = numbers[P::cost_numbers[t][k]];
  }

  // eight plans at a time; lanes beyond the last plan repeat the first of their pack
  int take(long first, int t) {
    const int lanes = int(count - first < LANES ? count - first : LANES);
    for (int lane = 0; lane < LANES; ++lane) {
      const long row = (first + (lane < lanes ? lane : 0)) * (T + 1) + t;
      for (int i = 0; i < n; ++i) x[i][lane] = states[row * n + i];
      for (int i = 0; i < m; ++i) u[i][lane] = controls[row * m + i];
    }
    return lanes;
  }

  void price(Real* costs) {
    for (int t = 0; t <= T; ++t) {
      at(t);
      for (long first = 0; first < count; first += LANES) {
        const int lanes = take(first, t);
        Pack each;
        P::cost(t, x, u, q, &each);
        for (int lane = 0; lane < lanes; ++lane) costs[(first + lane) * (T + 1) + t] = each[lane];
      }
    }
  }

  // the slopes by all numbers are added to w; a plan whose cost has none counts nothing, whatever its derivatives are
  void weigh(const Real* g_costs, Real* w) {
    for (int t = 0; t <= T; ++t) {
      at(t);
      const int kept = P::kind_numbers[P::cost_kind[t]];
      std::memset(total, 0, sizeof(total));
      for (long first = 0; first < count; first += LANES) {
        const int lanes = take(first, t);
        Pack weight = {};
        bool counts = false;
        for (int lane = 0; lane < lanes; ++lane) {
          weight[lane] = g_costs[(first + lane) * (T + 1) + t];
          counts = counts || weight[lane] != 0;
        }
        if (!counts) continue;
        P::cost_numbers_gradient(t, x, u, q, slopes);
        for (int k = 0; k < kept; ++k) total[k] += weight == Pack{} ? Pack{} : weight * slopes[k];
      }
      for (int k = 0; k < kept; ++k)
        for (int lane = 0; lane < LANES; ++lane) w[P::cost_numbers[t][k]] += total[k][lane];
    }
  }
};

}  // namespace dmmv

#pragma GCC visibility push(default)
extern "C" {

// parameters (problems, PARAMETERS), states (problems, plans, T + 1, n), controls (problems, plans, T + 1, m)
// -> costs (problems, plans, T + 1)
void dmmv_prices(long problems, long threads, long plans, const Real* parameters, const Real* states,
                 const Real* controls, Real* costs) {
  using P = Problem;
  const long rows = plans * (P::T + 1);
  dmmv::for_each(problems, threads, [=](long i) {
    thread_local dmmv::Plans<P> each;
    each.prepare(parameters + i * P::PARAMETERS, states + i * rows * P::n, controls + i * rows * P::m, plans);
    each.price(costs + i * rows);
  });
}

// Gradient by the parameters for that by the costs.
void dmmv_prices_adjoint(long problems, long threads, long plans, const Real* parameters, const Real* states,
                         const Real* controls, const Real* g_costs, Real* g_parameters) {
  using P = Problem;
  const long rows = plans * (P::T + 1);
  std::memset(g_parameters, 0, sizeof(Real) * problems * P::PARAMETERS);
  dmmv::for_each(problems, threads, [=](long i) {
    thread_local dmmv::Plans<P> each;
    thread_local std::vector<Real> w(P::NUMBERS + 1);
    const Real* own = parameters + i * P::PARAMETERS;
    each.prepare(own, states + i * rows * P::n, controls + i * rows * P::m, plans);
    std::fill(w.begin(), w.end(), Real(0));
    each.weigh(g_costs + i * rows, w.data());
    P::prelude_adjoint(own, w.data(), g_parameters + i * P::PARAMETERS);
  });
}

}  // extern "C"
#pragma GCC visibility pop
