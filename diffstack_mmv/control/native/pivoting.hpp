// Linear dynamics, quadratic costs and a box: block principal pivoting over the controls of all times, eight problems
// at a time.
//
// One guess of the active set is a Riccati recursion of the stages up to the last one where the guess is another, and
// a roll-out. Source: as box_qp.py.
#pragma once
#include "lane_recursion.hpp"

namespace dmmv {

template <class P>
struct Pivoting : LaneRecursion<P> {
  static constexpr int n = P::n, m = P::m, T = P::T;
  using Base = LaneRecursion<P>;
  using Base::x, Base::u, Base::k, Base::K, Base::Q_u, Base::Q_uu, Base::Q_ux, Base::gradient, Base::pivots;
  static constexpr Real HOPELESS = Real(0.3);  // share of contradictions of the first guess that are too many

  Real box[2][m];
  Pack side[T][m];      // -1 and 1: on a bound, 0: free
  Pack factored[T][m];  // those of the recursion as it stands
  bool is_factored = false, is_definite = false;  // `is_definite`: with all controls free, so that there is one solution
  Pack convex;          // the lanes where this is so, one or zero
  Mask found;
  Pack guesses;         // that each lane took until it was found

  bool tied(int i) const { return !(box[0][i] < box[1][i]); }

  // what the controls are held to, from where they and the gradient are
  void guess_sides() {
    for (int t = 0; t < T; ++t)
      for (int i = 0; i < m; ++i) {
        const Pack low = Pack{} + box[0][i], high = Pack{} + box[1][i], g = gradient[t][i];
        const Pack above = (u[t][i] >= high) & (g < Pack{}) ? Pack{} + 1 : Pack{};
        side[t][i] = tied(i) ? Pack{} + 1 : (u[t][i] <= low) & (g > Pack{}) ? Pack{} - 1 : above;
      }
  }

  // stages up to `last` for the sides
  void refactor(int last) {
    if (last == T - 1) this->begin();
    for (int t = last; t >= 0; --t) {
      Pack is_free[m], fixed[m];
      for (int i = 0; i < m; ++i) {
        is_free[i] = side[t][i] == Pack{} ? Pack{} + 1 : Pack{};
        const Pack above = side[t][i] > Pack{} ? Pack{} + box[1][i] : Pack{};
        fixed[i] = side[t][i] < Pack{} ? Pack{} + box[0][i] : above;
      }
      this->factor(t, is_free, nullptr);
      this->offset(t, fixed);
      std::memcpy(factored[t], side[t], sizeof(side[t]));
    }
    is_factored = true;
  }

  // the recursion that belongs to the sides, after another problem or box too
  void renew(bool all_new) {
    if (all_new) is_factored = is_definite = false;
    if (!is_definite) {
      Pack kept[T][m];
      std::memcpy(kept, side, sizeof(kept));
      std::memset(side, 0, sizeof(side));
      refactor(T - 1);
      convex = pivots[0] > Pack{} ? Pack{} + 1 : Pack{};
      std::memcpy(side, kept, sizeof(kept));
      is_definite = true;
    }
    refactor(last_other(true));
  }

  // the last stage with another set, -1 if there is none; `bounds`: bounds may be others too
  int last_other(bool bounds) const {
    if (!is_factored) return T - 1;
    for (int t = T - 1; t >= 0; --t)
      for (int i = 0; i < m; ++i) {
        const Mask other = side[t][i] != factored[t][i];
        if (any(bounds ? other | (side[t][i] != Pack{}) : other)) return t;
      }
    return -1;
  }

  // states and controls, and the sides they ask for; the number of contradictions and the last of them
  Pack contradictions(Pack (&wanted)[T][m], Pack& last) {
    Pack number = {};
    for (int t = 0; t < T; ++t) {
      Pack slope[m];
      std::memcpy(u[t], k[t], sizeof(k[t]));
      lane_apply<m, n>(K[t], x[t], u[t]);
      std::memcpy(slope, Q_u[t], sizeof(slope));
      lane_apply<m, m>(Q_uu[t], u[t], slope);
      lane_apply<m, n>(Q_ux[t], x[t], slope);
      for (int i = 0; i < m; ++i) {
        const Pack now = side[t][i], over = u[t][i] > Pack{} + box[1][i] ? Pack{} + 1 : Pack{};
        const Pack outside = u[t][i] < Pack{} + box[0][i] ? Pack{} - 1 : over;
        const Pack pulled = now * slope[i] > Pack{} ? Pack{} : now;
        wanted[t][i] = tied(i) ? now : now == Pack{} ? outside : pulled;
        const Mask other = wanted[t][i] != now;
        number += other ? Pack{} + 1 : Pack{};
        last = other ? Pack{} + Real(t * m + i) : last;
      }
      this->advance(t);
    }
    return number;
  }

  void exchange(const Pack (&wanted)[T][m], const Mask& all, const Mask& given_up, const Pack& last) {
    for (int t = 0; t < T; ++t)
      for (int i = 0; i < m; ++i) {
        const Mask taken = (all | (last == Pack{} + Real(t * m + i))) & ~given_up;
        side[t][i] = taken ? wanted[t][i] : side[t][i];
      }
  }

  // sides from a roll-out of the policies that keeps to the box, for lanes whose guess is hopeless
  void project(const Mask& hopeless) {
    Pack kept[T][m];
    std::memcpy(kept, side, sizeof(kept));
    for (int t = 0; t < T; ++t) {
      std::memcpy(u[t], k[t], sizeof(k[t]));
      lane_apply<m, n>(K[t], x[t], u[t]);
      for (int i = 0; i < m; ++i) u[t][i] = between(u[t][i], box[0][i], box[1][i]);
      this->advance(t);
    }
    this->gradients();
    guess_sides();
    for (int t = 0; t < T; ++t)
      for (int i = 0; i < m; ++i) side[t][i] = hopeless ? side[t][i] : kept[t][i];
  }

  // the number of recursions, from the sides as they are; lanes that are `found` stand at their solution
  int pivot(int most, int patience) {
    Pack wanted[T][m], fewest = Pack{} + Real(T * m + 1), last = {};
    Mask patient = ~Mask{}, given_up = Mask{};
    found = Mask{};
    for (int tried = 1;; ++tried) {
      const Pack number = contradictions(wanted, last);
      guesses = found ? guesses : Pack{} + Real(tried);
      found = number == Pack{};
      const Mask hopeless = number > Pack{} + HOPELESS * T * m;
      if (tried >= patience) given_up |= hopeless;
      if (tried == most || !any(~found & ~given_up)) return tried;
      const Mask fewer = number < fewest;
      exchange(wanted, fewer | patient, given_up, last);
      if (tried < patience && any(hopeless)) project(hopeless);
      fewest = least(fewest, number);
      patient = fewer;
      refactor(last_other(false));
    }
  }
};

}  // namespace dmmv
