// Derivatives of the solutions of linear-quadratic problems, eight at a time.
#pragma once
#include "adjoint.hpp"
#include "pivoting.hpp"

namespace dmmv {

// multiple of the rounding of the largest curvature by which the least pivot has to stand out
constexpr Real REGULAR = 1e4;

template <class P>
struct LaneAdjoint : Pivoting<P> {
  static constexpr int n = P::n, m = P::m, T = P::T;
  static constexpr int rows = (T + 1) * n, entries = T * m;
  using Base = Pivoting<P>;
  using Base::x, Base::u, Base::dx, Base::du, Base::p, Base::V_xx, Base::Q_uu, Base::costate, Base::pivots;

  Pack by_x[T + 1][n], by_u[T][m];
  Adjoint<P> scalar;
  long prepared = 0;  // version of the problem that `scalar` has
  Real weights[P::NUMBERS + 1];

  void operator()(const Slopes& given, const long* problems, int count) {
    bool all_new = false;
    for (int lane = 0; lane < LANES; ++lane) {
      const long i = problems[lane < count ? lane : 0];
      all_new = this->load(lane, given.parameters + i * P::PARAMETERS) || all_new;
      this->put(lane, given.x + i * rows, x[0], rows);
      this->put(lane, given.u + i * entries, u[0], entries);
      for (int t = 0; t <= T; ++t)
        for (int j = 0; j < n; ++j) by_x[t][j][lane] = -given.g_x[i * rows + t * n + j];
      for (int t = 0; t < T; ++t)
        for (int j = 0; j < m; ++j) by_u[t][j][lane] = -given.g_u[i * entries + t * m + j];
    }
    this->gradients();
    this->guess_sides();
    if (all_new) this->is_factored = false;
    this->refactor(this->last_other(true));
    this->template correct<true>(by_u, by_x);
    for (int t = 0; t < T; ++t) lane_apply<n, n>(V_xx[t + 1], dx[t + 1], p[t + 1]);
    for (int lane = 0; lane < count; ++lane) {
      if (is_regular(lane)) {
        put_out(given, problems[lane], lane);
      } else {
        scalar(given, problems[lane]);
        prepared = 0;
      }
    }
  }

  // whether no control is flat; `Adjoint` knows what to do with those
  bool is_regular(int lane) const {
    Real most = 0;
    for (int t = 0; t < T; ++t)
      for (int i = 0; i < m; ++i) most = op_max(most, Q_uu[t][i * m + i][lane]);
    return pivots[0][lane] > REGULAR * std::numeric_limits<Real>::epsilon() * most;
  }

  static void get(int lane, const Pack* from, Real* to, int number) {
    for (int i = 0; i < number; ++i) to[i] = from[i][lane];
  }

  void put_out(const Slopes& given, long i, int lane) {
    const Real* own = given.parameters + i * P::PARAMETERS;
    Real* by_state = given.g_state + i * n;
    this->fetch(own);
    if (prepared != this->version) scalar.prepare(own, given.bounds);
    prepared = this->version;
    std::memcpy(scalar.x, given.x + i * rows, sizeof(Real) * rows);
    std::memcpy(scalar.u, given.u + i * entries, sizeof(Real) * entries);
    get(lane, dx[0], scalar.dx[0], rows);
    get(lane, du[0], scalar.du[0], entries);
    get(lane, costate[1], scalar.costate[0], T * n);
    get(lane, p[1], scalar.dl[0], T * n);
    std::memset(scalar.du[T], 0, sizeof(scalar.du[T]));
    std::memset(weights, 0, sizeof(weights));
    scalar.weigh(given.g_cost[i], weights);
    P::prelude_adjoint(own, weights, given.g_parameters + i * P::PARAMETERS);
    const Real* H_ux = this->one.H_ux[P::cost_alike[0]];
    for (int j = 0; j < n; ++j) by_state[j] = given.g_x[i * rows + j] + given.g_cost[i] * costate[0][j][lane];
    for (int k = 0; k < n; ++k)
      for (int j = 0; j < n; ++j) by_state[j] -= this->one.A[k * n + j] * scalar.dl[0][k];
    for (int k = 0; k < m; ++k)
      for (int j = 0; j < n; ++j) by_state[j] -= H_ux[k * n + j] * scalar.du[0][k];
  }
};

template <class P>
void differentiate_linear_quadratic(const Slopes& given, long threads) {
  std::vector<long> valid;
  for (long i = 0; i < given.count; ++i)
    if (given.valid[i]) valid.push_back(i);
  const long number = long(valid.size());
  for_each((number + LANES - 1) / LANES, threads, [&](long group) {
    static thread_local LaneAdjoint<P> lanes;
    std::memcpy(lanes.box, given.bounds, sizeof(lanes.box));
    lanes(given, valid.data() + group * LANES, int(std::min(long(LANES), number - group * LANES)));
  });
}

}  // namespace dmmv
