// Linear dynamics, quadratic costs and a box: block principal pivoting over the controls of all times.
//
// One guess of the active set is one Riccati recursion without a line search, so that the iterations start from the
// solution. Source: as box_qp.py.
#pragma once
#include "small.hpp"

namespace dmmv {

template <class P>
struct Pivoting {
  static constexpr int n = P::n, m = P::m, T = P::T;
  static constexpr int MOST = 30;  // guesses
  static constexpr Real HOPELESS = Real(0.3);  // share of contradictions of the first guess that are too many

  bool found;
  int side[T][m];  // -1 and 1: on a bound, 0: free
  Real change[T][m];
  Real K[T][m * n], k[T][m], Q_u[T][m], Q_uu[T][m * m], Q_ux[T][m * n];

  // optimal changes of the controls, those on a side moved onto their bound; false if there are none
  template <class S>
  bool recursion(const S& at) {
    Real V_x[n], V_xx[n * n];
    std::memcpy(V_x, at.c_x[T], sizeof(V_x));
    std::memcpy(V_xx, at.H_xx[T], sizeof(V_xx));
    for (int t = T - 1; t >= 0; --t) {
      Real Q_x[n], Q_xx[n * n], VA[n * n], VB[n * m], inverse[m * m], product_[m * n], rest[m];
      bool is_free[m];
      std::memcpy(Q_x, at.c_x[t], sizeof(Q_x));
      std::memcpy(Q_xx, at.H_xx[t], sizeof(Q_xx));
      std::memcpy(Q_u[t], at.c_u[t], sizeof(Q_u[t]));
      std::memcpy(Q_ux[t], at.H_ux[t], sizeof(Q_ux[t]));
      std::memcpy(Q_uu[t], at.H_uu[t], sizeof(Q_uu[t]));
      add_transposed_apply<n, n>(at.A[t], V_x, Q_x);
      add_transposed_apply<n, m>(at.B[t], V_x, Q_u[t]);
      product<n, n, n>(V_xx, at.A[t], VA);
      product<n, n, m>(V_xx, at.B[t], VB);
      add_transposed_product<n, n, n>(at.A[t], VA, Q_xx);
      add_transposed_product<n, m, n>(at.B[t], VA, Q_ux[t]);
      add_transposed_product<n, m, m>(at.B[t], VB, Q_uu[t]);
      for (int i = 0; i < m; ++i) is_free[i] = side[t][i] == 0;
      if (!definite_inverse<m>(Q_uu[t], is_free, inverse)) return false;
      for (int i = 0; i < m; ++i) k[t][i] = side[t][i] ? at.box[side[t][i] > 0][i] - at.u[t][i] : Real(0);
      std::memcpy(rest, Q_u[t], sizeof(rest));
      add_product<m, m>(Q_uu[t], k[t], rest);
      product<m, m, n>(inverse, Q_ux[t], product_);
      for (int i = 0; i < m * n; ++i) K[t][i] = -product_[i];
      for (int i = 0; i < m; ++i)
        for (int j = 0; j < m; ++j) k[t][i] -= inverse[i * m + j] * rest[j];
      std::memcpy(V_x, Q_x, sizeof(V_x));
      add_transposed_apply<m, n>(Q_ux[t], k[t], V_x);
      std::memcpy(V_xx, Q_xx, sizeof(V_xx));
      add_transposed_product<m, n, n>(Q_ux[t], K[t], V_xx);
      make_symmetric<n>(V_xx);
    }
    return true;
  }

  // the changes, and which sides they ask for; the number of contradictions and the last of them
  template <class S>
  int contradictions(const S& at, int (&wanted)[T][m], int& last) {
    int number = 0;
    Real dx[n] = {};
    for (int t = 0; t < T; ++t) {
      std::memcpy(change[t], k[t], sizeof(k[t]));
      add_product<m, n>(K[t], dx, change[t]);
      Real slope[m], next[n] = {};
      std::memcpy(slope, Q_u[t], sizeof(slope));
      add_product<m, m>(Q_uu[t], change[t], slope);
      add_product<m, n>(Q_ux[t], dx, slope);
      for (int i = 0; i < m; ++i) {
        const Real moved = at.u[t][i] + change[t][i];
        const int now = side[t][i];
        if (now)
          wanted[t][i] = now * slope[i] > 0 ? 0 : now;
        else
          wanted[t][i] = moved < at.box[0][i] ? -1 : moved > at.box[1][i] ? 1 : 0;
        if (wanted[t][i] == now) continue;
        ++number;
        last = t * m + i;
      }
      add_product<n, n>(at.A[t], dx, next);
      add_product<n, m>(at.B[t], change[t], next);
      std::memcpy(dx, next, sizeof(dx));
    }
    return number;
  }

  // the number of recursions, from the sides as they are; if `found`, `change` leads to the solution
  template <class S>
  int operator()(const S& at) {
    int wanted[T][m], fewest = T * m + 1, last = 0;
    bool patient = true;
    found = false;
    for (int tried = 1; tried <= MOST; ++tried) {
      if (!recursion(at)) return tried;
      const int number = contradictions(at, wanted, last);
      if (number == 0) {
        found = true;
        return tried;
      }
      const bool fewer = number < fewest;
      if (fewer || patient)
        std::memcpy(side, wanted, sizeof(side));
      else
        side[last / m][last % m] = wanted[last / m][last % m];
      if (tried == 1 && number > HOPELESS * T * m) return tried;
      fewest = std::min(fewest, number);
      patient = fewer;
    }
    return MOST;
  }
};

}  // namespace dmmv
