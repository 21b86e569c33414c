// The Riccati recursion of eight linear-quadratic problems, of which stages may stay as they are.
#pragma once
#include "lanes.hpp"

namespace dmmv {

template <class P>
struct LaneRecursion : LaneModel<P> {
  static constexpr int n = P::n, m = P::m, T = P::T;
  using Base = LaneModel<P>;
  using Base::A, Base::B, Base::c, Base::H_xx, Base::H_ux, Base::H_uu, Base::g_x, Base::g_u;

  // value functions and policies
  Pack V_xx[T + 1][n * n], V_x[T + 1][n], Q_uu[T][m * m], Q_ux[T][m * n], Q_u[T][m], inverse[T][m * m];
  Pack K[T][m * n], k[T][m], pivots[T + 1];

  // where the problems stand; gradient of the costs by the controls, costates, and what rounding acts on
  Pack x[T + 1][n], u[T][m], gradient[T][m], costate[T + 1][n], change;

  // a change of them
  Pack dx[T + 1][n], du[T][m], p[T + 1][n], decrease;

  void begin() {
    const int h = P::cost_alike[T];
    std::memcpy(V_xx[T], H_xx[h], sizeof(V_xx[T]));
    std::memcpy(V_x[T], g_x[h], sizeof(V_x[T]));
    pivots[T] = Pack{} + std::numeric_limits<Real>::max();
  }

  // one stage from the one after it; `added` to the diagonal of Q_uu
  void factor(int t, const Pack* is_free, const Pack* added) {
    const int h = P::cost_alike[t];
    Pack VA[n * n] = {}, VB[n * m] = {};
    lane_product<n, n, n, n, 1>(V_xx[t + 1], A, VA);
    lane_product<n, n, m, n, 1>(V_xx[t + 1], B, VB);
    std::memcpy(V_xx[t], H_xx[h], sizeof(V_xx[t]));
    std::memcpy(Q_ux[t], H_ux[h], sizeof(Q_ux[t]));
    std::memcpy(Q_uu[t], H_uu[h], sizeof(Q_uu[t]));
    lane_product<n, n, n, 1, n, true>(A, VA, V_xx[t]);
    lane_product<m, n, n, 1, m>(B, VA, Q_ux[t]);
    lane_product<m, n, m, 1, m, true>(B, VB, Q_uu[t]);
    if (added)
      for (int i = 0; i < m; ++i) Q_uu[t][i * m + i] += added[i];
    pivots[t] = least(pivots[t + 1], lane_inverse<m>(Q_uu[t], is_free, inverse[t]));
    for (Pack& entry : K[t]) entry = Pack{};
    lane_product<m, m, n, m, 1>(inverse[t], Q_ux[t], K[t]);
    for (Pack& entry : K[t]) entry = -entry;
    lane_product<n, m, n, 1, n, true>(Q_ux[t], K[t], V_xx[t]);
  }

  // the linear terms of a stage; `fixed`: values of the controls that are not free
  void offset(int t, const Pack* fixed) {
    const int h = P::cost_alike[t];
    Pack after[n], rest[m];
    std::memcpy(after, V_x[t + 1], sizeof(after));
    lane_apply<n, n>(V_xx[t + 1], c, after);
    std::memcpy(V_x[t], g_x[h], sizeof(V_x[t]));
    std::memcpy(Q_u[t], g_u[h], sizeof(Q_u[t]));
    lane_transposed_apply<n, n>(A, after, V_x[t]);
    lane_transposed_apply<n, m>(B, after, Q_u[t]);
    std::memcpy(rest, Q_u[t], sizeof(rest));
    lane_apply<m, m>(Q_uu[t], fixed, rest);
    for (int i = 0; i < m; ++i) {
      k[t][i] = fixed[i];
      for (int j = 0; j < m; ++j) k[t][i] -= inverse[t][i * m + j] * rest[j];
    }
    lane_transposed_apply<m, n>(Q_ux[t], k[t], V_x[t]);
  }

  // the states after one step
  void advance(int t) {
    std::memcpy(x[t + 1], c, sizeof(c));
    lane_apply<n, n>(A, x[t], x[t + 1]);
    lane_apply<n, m>(B, u[t], x[t + 1]);
  }

  void differentiate() {
    for (int t = 0; t < T; ++t) advance(t);
    gradients();
  }

  // costates and gradient where states and controls are
  void gradients() {
    change = Pack{};
    for (int t = T; t >= 0; --t) {
      const int h = P::cost_alike[t];
      std::memcpy(costate[t], g_x[h], sizeof(costate[t]));
      lane_apply<n, n>(H_xx[h], x[t], costate[t]);
      if (t < T) {
        std::memcpy(gradient[t], g_u[h], sizeof(gradient[t]));
        lane_apply<m, m>(H_uu[h], u[t], gradient[t]);
        lane_apply<m, n>(H_ux[h], x[t], gradient[t]);
        lane_transposed_apply<m, n>(H_ux[h], u[t], costate[t]);
        for (int i = 0; i < m; ++i) change += magnitude(u[t][i] * gradient[t][i]);
      }
      for (int i = 0; i < n; ++i) change += magnitude(x[t][i] * costate[t][i]);
      if (t == T) continue;
      lane_transposed_apply<n, m>(B, costate[t + 1], gradient[t]);
      lane_transposed_apply<n, n>(A, costate[t + 1], costate[t]);
    }
  }

  // stationary change of the factorised model, without offsets, under gradients by the controls (and the states)
  template <bool STATES>
  void correct(const Pack (*by_u)[m], const Pack (*by_x)[n] = nullptr) {
    for (int i = 0; i < n; ++i) {
      p[T][i] = STATES ? by_x[T][i] : Pack{};
      dx[0][i] = Pack{};
    }
    decrease = Pack{};
    for (int t = T - 1; t >= 0; --t) {
      Pack slope[m];
      std::memcpy(slope, by_u[t], sizeof(slope));
      lane_transposed_apply<n, m>(B, p[t + 1], slope);
      for (int i = 0; i < m; ++i) {
        du[t][i] = Pack{};
        for (int j = 0; j < m; ++j) du[t][i] -= inverse[t][i * m + j] * slope[j];
        decrease -= Real(0.5) * slope[i] * du[t][i];
      }
      for (int i = 0; i < n; ++i) p[t][i] = STATES ? by_x[t][i] : Pack{};
      lane_transposed_apply<n, n>(A, p[t + 1], p[t]);
      lane_transposed_apply<m, n>(Q_ux[t], du[t], p[t]);
    }
    for (int t = 0; t < T; ++t) {
      lane_apply<m, n>(K[t], dx[t], du[t]);
      for (Pack& entry : dx[t + 1]) entry = Pack{};
      lane_apply<n, n>(A, dx[t], dx[t + 1]);
      lane_apply<n, m>(B, du[t], dx[t + 1]);
    }
  }
};

}  // namespace dmmv
