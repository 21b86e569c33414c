// Derivatives of generated functions, eight columns at a time.
#pragma once
#include "small.hpp"

namespace dmmv {

// values (R) and columns (R, n + m) of the Jacobian of f(x, u) for the active columns
template <int n, int m, int R, size_t K, class F>
inline void columns(const Real* x, const Real* u, const int (&active)[K], F f, Real* values, Real* J) {
  for (size_t first = 0; first < K; first += LANES) {
    Dual<Pack> z[n + m], out[R];
    for (int i = 0; i < n; ++i) z[i] = {x[i], Pack{}};
    for (int i = 0; i < m; ++i) z[n + i] = {u[i], Pack{}};
    const size_t count = K - first < LANES ? K - first : LANES;
    for (size_t lane = 0; lane < count; ++lane)
      if (active[first + lane] >= 0) z[active[first + lane]].d[lane] = 1;
    f(z, z + n, out);
    for (int r = 0; r < R; ++r) {
      values[r] = out[r].v;
      for (size_t lane = 0; lane < count; ++lane)
        if (active[first + lane] >= 0) J[r * (n + m) + active[first + lane]] = out[r].d[lane];
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

}  // namespace dmmv
