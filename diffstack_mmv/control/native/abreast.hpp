// The moments of eight roll-outs side by side, for steps whose derivatives are written out: see moments.hpp.
//
// The generated `Problem` has the step with its Jacobian, and the slopes of both.
#pragma once
#include "numbers.hpp"

namespace dmmv {

// eight rows, one after the other or by their numbers; lanes beyond the last row repeat the first
struct Eight {
  long first;
  int lanes;
  const long* rows = nullptr;

  long row(int lane) const {
    const long place = first + (lane < lanes ? lane : 0);
    return rows ? rows[place] : place;
  }
  template <int count>
  void take(const Real* from, long stride, Pack* to) const {
    for (int lane = 0; lane < LANES; ++lane)
      for (int i = 0; i < count; ++i) to[i][lane] = from[row(lane) * stride + i];
  }
  template <int count>
  void give(const Pack* from, Real* to, long stride) const {
    for (int lane = 0; lane < lanes; ++lane)
      for (int i = 0; i < count; ++i) to[row(lane) * stride + i] = from[i][lane];
  }

  // what was kept of time t: packs of the eight rows that were side by side then
  template <int count>
  static Real* place(Real* kept, long row, long T, long t) {
    return kept + ((row - row % LANES) * T + t * LANES) * count;
  }
  template <int count>
  void recall(Real* kept, long T, long t, Pack* to) const {
    if (row(0) % LANES == 0 && row(LANES - 1) == row(0) + LANES - 1) {
      std::memcpy(to, place<count>(kept, row(0), T, t), count * sizeof(Pack));
      return;
    }
    for (int lane = 0; lane < LANES; ++lane) {
      const Real* from = place<count>(kept, row(lane), T, t) + row(lane) % LANES;
      for (int i = 0; i < count; ++i) to[i][lane] = from[i * LANES];
    }
  }
};

// C (a, b) = A (a, k) B (b, k)'
template <int a, int k, int b>
inline void product_turned(const Pack* A, const Pack* B, Pack* C) {
  for (int i = 0; i < a; ++i)
    for (int j = 0; j < b; ++j) {
      Pack sum = {};
      for (int l = 0; l < k; ++l) sum += A[i * k + l] * B[j * k + l];
      C[i * b + j] = sum;
    }
}

template <class P>
struct Abreast {
  static constexpr int n = P::n, m = P::m, k = n + m, KEPT = n + n * n + n * k;

  static void split(const Pack* J, Pack* A, Pack* B) {
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < n; ++j) A[i * n + j] = J[i * k + j];
      for (int j = 0; j < m; ++j) B[i * m + j] = J[i * k + n + j];
    }
  }

  static void forward(const Eight& rows, long T, const Real* q, const Real* start, const Real* first, const Real* u_,
                      const Real* scale, Real* mean, Real* covariance, Real* kept) {
    Pack x[n], y[n], S[n * n], J[n * k], A[n * n], B[n * m], AS[n * n], D[n * m], u[m], L[m * m], turned[m * m];
    rows.take<n>(start, n, x);
    rows.take<n * n>(first, n * n, S);
    for (long t = 0; t < T; ++t) {
      rows.take<m>(u_ + t * m, T * m, u);
      rows.take<m * m>(scale + t * m * m, T * m * m, L);
      P::step_abreast(x, u, q, y, J);
      if (kept) {
        Real* own = Eight::place<KEPT>(kept, rows.first, T, t);
        std::memcpy(own, x, sizeof(x));
        std::memcpy(own + n * LANES, S, sizeof(S));
        std::memcpy(own + (n + n * n) * LANES, J, sizeof(J));
      }
      split(J, A, B);
      product_turned<n, n, n>(A, S, AS);  // S is symmetric
      for (int i = 0; i < m; ++i)
        for (int j = 0; j < m; ++j) turned[i * m + j] = L[j * m + i];
      product_turned<n, m, m>(B, turned, D);
      for (int i = 0; i < n; ++i)
        for (int j = 0; j <= i; ++j) {
          Pack s = {};
          for (int l = 0; l < n; ++l) s += AS[i * n + l] * A[j * n + l];
          for (int l = 0; l < m; ++l) s += D[i * m + l] * D[j * m + l];
          S[i * n + j] = S[j * n + i] = s;
        }
      std::memcpy(x, y, sizeof(x));
      const Pack block[] = {S[0], S[1], S[n], S[n + 1]};
      rows.give<2>(x, mean + t * 2, T * 2);
      rows.give<4>(block, covariance + t * 4, T * 4);
    }
  }

  static void backward(const Eight& rows, long T, const Real* q, const Real* u_, const Real* scale, Real* kept,
                       const Real* g_mean, const Real* g_covariance, Real* g_start, Real* g_first, Real* g_u,
                       Real* g_scale, Real* numbers) {
    Pack slope[n] = {}, W[n * n] = {}, sums[P::NUMBERS + 1] = {};
    for (long t = T - 1; t >= 0; --t) {
      Pack own[KEPT];
      rows.recall<KEPT>(kept, T, t, own);
      const Pack *x = own, *S = own + n, *J = own + n + n * n;
      Pack A[n * n], B[n * m], L[m * m], u[m], by_mean[2], by_covariance[4], z[k], G[n * k], by_scale[m * m];
      Pack D[n * m], WA[n * n], turned[n * n], G_D[n * m];
      rows.take<m>(u_ + t * m, T * m, u);
      rows.take<m * m>(scale + t * m * m, T * m * m, L);
      rows.take<2>(g_mean + t * 2, T * 2, by_mean);
      rows.take<4>(g_covariance + t * 4, T * 4, by_covariance);
      for (int i = 0; i < 2; ++i) {
        slope[i] += by_mean[i];
        for (int j = 0; j < 2; ++j) W[i * n + j] += Real(0.5) * (by_covariance[i * 2 + j] + by_covariance[j * 2 + i]);
      }
      split(J, A, B);
      for (int i = 0; i < n; ++i)
        for (int j = 0; j < n; ++j) turned[i * n + j] = A[j * n + i];
      product_turned<n, n, n>(W, turned, WA);
      for (int i = 0; i < n; ++i)
        for (int j = 0; j < m; ++j) {
          Pack s = {};
          for (int l = 0; l < m; ++l) s += B[i * m + l] * L[l * m + j];
          D[i * m + j] = s;
        }
      for (int i = 0; i < n; ++i)
        for (int j = 0; j < m; ++j) {
          Pack s = {};
          for (int l = 0; l < n; ++l) s += W[i * n + l] * D[l * m + j];
          G_D[i * m + j] = 2 * s;
        }
      for (int i = 0; i < m; ++i)
        for (int j = 0; j < m; ++j) {
          Pack s = {};
          for (int l = 0; l < n; ++l) s += B[l * m + i] * G_D[l * m + j];
          by_scale[i * m + j] = s;
        }
      for (int i = 0; i < n; ++i) {
        for (int j = 0; j < n; ++j) {
          Pack s = {};
          for (int l = 0; l < n; ++l) s += WA[i * n + l] * S[l * n + j];
          G[i * k + j] = 2 * s;
        }
        for (int j = 0; j < m; ++j) {
          Pack s = {};
          for (int l = 0; l < m; ++l) s += G_D[i * m + l] * L[j * m + l];
          G[i * k + n + j] = s;
        }
      }
      P::pull_abreast(x, u, q, slope, G, z, sums);
      std::memcpy(slope, z, sizeof(slope));
      for (int i = 0; i < n; ++i)
        for (int j = 0; j <= i; ++j) {
          Pack s = {};
          for (int l = 0; l < n; ++l) s += A[l * n + i] * WA[l * n + j];
          W[i * n + j] = W[j * n + i] = s;
        }
      rows.give<m>(z + n, g_u + t * m, T * m);
      rows.give<m * m>(by_scale, g_scale + t * m * m, T * m * m);
    }
    rows.give<n>(slope, g_start, n);
    rows.give<n * n>(W, g_first, n * n);
    for (int i = 0; i < P::NUMBERS; ++i)
      for (int lane = 0; lane < rows.lanes; ++lane) numbers[i] += sums[i][lane];
  }
};

}  // namespace dmmv
