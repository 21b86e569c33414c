// Derivatives of generated functions, eight columns at a time.
#pragma once
#include "small.hpp"

namespace dmmv {

// values (R) and columns (R, n + m) of the Jacobian of f(x, u) for the active columns
template <int n, int m, int R, class F>
inline void columns(const Real* x, const Real* u, const int* active, int K, F f, Real* values, Real* J) {
  for (int first = 0; first < K || first == 0; first += LANES) {
    Dual<Pack> z[n + m], out[R];
    for (int i = 0; i < n; ++i) z[i] = {x[i], Pack{}};
    for (int i = 0; i < m; ++i) z[n + i] = {u[i], Pack{}};
    const int count = K - first < LANES ? K - first : LANES;
    for (int lane = 0; lane < count; ++lane) z[active[first + lane]].d[lane] = 1;
    f(z, z + n, out);
    for (int r = 0; r < R; ++r) {
      values[r] = out[r].v;
      for (int lane = 0; lane < count; ++lane) J[r * (n + m) + active[first + lane]] = out[r].d[lane];
    }
  }
}

// A and B from (n, n + m)
template <int n, int m>
inline void split_jacobian(const Real* J, Real* A, Real* B) {
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) A[i * n + j] = J[i * (n + m) + j];
    for (int j = 0; j < m; ++j) B[i * m + j] = J[i * (n + m) + n + j];
  }
}

// adds the blocks of a Hessian (n + m, n + m), its symmetric part
template <int n, int m>
inline void add_blocks(const Real* H, Real* xx, Real* ux, Real* uu) {
  constexpr int k = n + m;
  auto entry = [&](int i, int j) { return Real(0.5) * (H[i * k + j] + H[j * k + i]); };
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < n; ++j) xx[i * n + j] += entry(i, j);
  for (int i = 0; i < m; ++i) {
    for (int j = 0; j < n; ++j) ux[i * n + j] += entry(n + i, j);
    for (int j = 0; j < m; ++j) uu[i * m + j] += entry(n + i, n + j);
  }
}

// A and B of one step
template <class P>
inline void step_jacobian(const Real* x, const Real* u, const Real* q, Real* A, Real* B) {
  constexpr int n = P::n, m = P::m;
  Real J[n * (n + m)], y[n];
  if constexpr (P::JACOBIAN_WRITTEN) {
    P::step_jacobian(x, u, q, J);
    return split_jacobian<n, m>(J, A, B);
  }
  std::memcpy(J, P::step_constant, sizeof(J));
  auto f = [&](const auto* x, const auto* u, auto* y) { P::step(x, u, q, y); };
  columns<n, m, n>(x, u, P::step_active, P::STEP_ACTIVE, f, y, J);
  split_jacobian<n, m>(J, A, B);
}

// adds the Hessian of l . f
template <class P>
inline void add_step_hessian(const Real* x, const Real* u, const Real* l, const Real* q, Real* xx, Real* ux, Real* uu) {
  constexpr int n = P::n, m = P::m, k = n + m;
  Real H[(k + n) * k] = {}, g[k + n];
  if constexpr (P::HESSIAN_WRITTEN) {
    P::step_hessian(x, u, l, q, H);
    return add_blocks<n, m>(H, xx, ux, uu);
  }
  auto f = [&](const auto* x, const auto* u, auto* y) { P::step_gradient(x, u, l, q, y); };
  columns<n, m, k + n>(x, u, P::step_active, P::STEP_ACTIVE, f, g, H);
  add_blocks<n, m>(H, xx, ux, uu);
}

// A, B and the Hessian: what differentiates the gradient of l . f differentiates f as well
template <class P>
inline void step_model(const Real* x, const Real* u, const Real* l, const Real* q, Real* A, Real* B, Real* xx, Real* ux,
                       Real* uu) {
  constexpr int n = P::n, m = P::m, k = n + m;
  if constexpr (P::HESSIAN_WRITTEN || P::JACOBIAN_WRITTEN) {
    step_jacobian<P>(x, u, q, A, B);
    add_step_hessian<P>(x, u, l, q, xx, ux, uu);
    return;
  }
  Real H[(k + n) * k] = {}, g[k + n];
  std::memcpy(H + k * k, P::step_constant, sizeof(Real) * n * k);
  auto f = [&](const auto* x, const auto* u, auto* y) { P::step_gradient(x, u, l, q, y); };
  columns<n, m, k + n>(x, u, P::step_active, P::STEP_ACTIVE, f, g, H);
  add_blocks<n, m>(H, xx, ux, uu);
  split_jacobian<n, m>(H + k * k, A, B);
}

// cost of one time, its gradient and its Hessian
template <class P>
inline Real cost_model(int t, const Real* x, const Real* u, const Real* q, Real* c_x, Real* c_u, Real* xx, Real* ux,
                       Real* uu) {
  constexpr int n = P::n, m = P::m, k = n + m;
  Real H[(k + 1) * k] = {}, g[k + 1];
  auto f = [&](const auto* x, const auto* u, auto* y) { P::cost_gradient(t, x, u, q, y); };
  const int kind = P::cost_kind[t];
  if constexpr (P::COST_WRITTEN) {
    P::cost_gradient(t, x, u, q, g);
    P::cost_hessian(t, x, u, q, H);
  } else {
    columns<n, m, k + 1>(x, u, P::cost_active[kind], P::cost_columns[kind], f, g, H);
  }
  if constexpr (P::TERMS_WRITTEN) {
    Real added[k + 1 + k * k] = {};
    P::add_terms(t, x, u, q, added);
    for (int i = 0; i <= k; ++i) g[i] += added[i];
    for (int i = 0; i < k * k; ++i) H[i] += added[k + 1 + i];
  }
  std::memset(xx, 0, n * n * sizeof(Real));
  std::memset(ux, 0, m * n * sizeof(Real));
  std::memset(uu, 0, m * m * sizeof(Real));
  add_blocks<n, m>(H, xx, ux, uu);
  std::memcpy(c_x, g, n * sizeof(Real));
  std::memcpy(c_u, g + n, m * sizeof(Real));
  return g[k];
}

}  // namespace dmmv
