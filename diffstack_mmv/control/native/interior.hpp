// Linear dynamics, quadratic costs and a box where guesses of the active set contradict one another: a primal-dual
// interior-point method, eight problems at a time, until it tells the active sets.
//
// Source: Mehrotra, On the implementation of a primal-dual interior point method, SIAM J. Optim. 2 (1992), with steps
// of their own for controls and multipliers.
#pragma once
#include "pivoting.hpp"

namespace dmmv {

template <class P>
struct Interior : Pivoting<P> {
  static constexpr int n = P::n, m = P::m, T = P::T;
  using Base = Pivoting<P>;
  using Base::box, Base::x, Base::u, Base::gradient, Base::du, Base::side, Base::found;
  static constexpr int MOST = 60, GUESSES = 6;
  static constexpr Real KEPT = Real(0.995), FIRST = Real(0.1);
  static constexpr Real SMALL = std::numeric_limits<Real>::min() * Real(1e10);

  // both bounds of a control: room to them, multipliers, their changes
  struct Wall {
    Pack room, price, change;
  };
  Wall walls[T][m][2];
  Pack stiffness[T][m], residual[T][m], mean, expected;
  Real width[m];
  bool is_bounded[2][m];

  static Real sign(int s) { return s ? Real(-1) : Real(1); }  // of the room by the control

  template <class F>
  void each(F f) {
    for (int t = 0; t < T; ++t)
      for (int i = 0; i < m; ++i)
        for (int s = 0; s < 2; ++s)
          if (is_bounded[s][i]) f(t, i, walls[t][i][s], sign(s));
  }

  // in the middle of the box; where it has one side or none, near where the controls are
  void place() {
    for (int i = 0; i < m; ++i) {
      is_bounded[0][i] = !this->tied(i) && finite(box[0][i]);
      is_bounded[1][i] = !this->tied(i) && finite(box[1][i]);
      const bool both = finite(box[0][i]) && finite(box[1][i]);
      width[i] = both ? std::max(Real(0.5) * (box[1][i] - box[0][i]), SMALL) : Real(1);
      for (int t = 0; t < T; ++t) {
        if (both) u[t][i] = Pack{} + Real(0.5) * (box[0][i] + box[1][i]);
        else if (is_bounded[0][i]) u[t][i] = most(u[t][i], Pack{} + (box[0][i] + 1));
        else if (is_bounded[1][i]) u[t][i] = least(u[t][i], Pack{} + (box[1][i] - 1));
      }
    }
    this->differentiate();
    Pack largest = {};
    std::memset(du, 0, sizeof(du));
    expected = Pack{} + SMALL;
    for (int t = 0; t < T; ++t)
      for (int i = 0; i < m; ++i) {
        const Pack saved = magnitude(gradient[t][i]) * width[i];
        largest = most(largest, saved);
        expected += saved;
      }
    each([&](int t, int i, Wall& wall, Real sign) {
      const Pack pressing = most(sign * gradient[t][i], Pack{});
      wall.room = sign > 0 ? u[t][i] - box[0][i] : box[1][i] - u[t][i];
      wall.price = pressing + (FIRST * largest + SMALL) / width[i];
      wall.change = Pack{};
    });
  }

  // mean product of room and price, after a step
  Pack complementarity(const Pack& by_u, const Pack& by_price) {
    Pack sum = {};
    Real count = 0;
    each([&](int t, int i, Wall& wall, Real sign) {
      sum += (wall.room + by_u * sign * du[t][i]) * (wall.price + by_price * wall.change);
      ++count;
    });
    return sum / std::max(count, Real(1));
  }

  void factor() {
    const Pack one = Pack{} + 1;
    for (auto& row : stiffness)
      for (Pack& entry : row) entry = Pack{};
    each([&](int t, int i, Wall& wall, Real) { stiffness[t][i] += wall.price / wall.room; });
    Pack is_free[m];
    for (int i = 0; i < m; ++i) is_free[i] = this->tied(i) ? Pack{} : one;
    for (int t = T - 1; t >= 0; --t) LaneRecursion<P>::factor(t, is_free, stiffness[t]);
    this->is_factored = this->is_definite = false;
  }

  // Newton's step towards products `target`; `second`: with the product of the changes of the step before
  void step(const Pack& target, bool second) {
    std::memcpy(residual, gradient, sizeof(residual));
    auto wanted = [&](int t, int i, const Wall& wall, Real sign) {
      const Pack curved = second ? sign * du[t][i] * wall.change : Pack{};
      return target - curved;
    };
    each([&](int t, int i, Wall& wall, Real sign) {
      wall.change = wanted(t, i, wall, sign);  // room * change of the price + price * (room + change of the room)
      residual[t][i] -= sign * wall.change / wall.room;
    });
    this->template correct<false>(residual);
    each([&](int t, int i, Wall& wall, Real sign) {
      wall.change = (wall.change - wall.price * (wall.room + sign * du[t][i])) / wall.room;
    });
  }

  // the longest steps that leave room and prices positive
  void longest(Pack& by_u, Pack& by_price) {
    Pack room = Pack{} + 1, price = Pack{} + 1;
    each([&](int t, int i, Wall& wall, Real sign) {
      const Pack closing = -sign * du[t][i], falling = -wall.change;
      room = closing * room > wall.room ? wall.room / closing : room;
      price = falling * price > wall.price ? wall.price / falling : price;
    });
    by_u = room;
    by_price = price;
  }

  void move(const Pack& by_u, const Pack& by_price) {
    for (int t = 0; t < T; ++t)
      for (int i = 0; i < m; ++i) {
        gradient[t][i] -= by_u * (residual[t][i] + stiffness[t][i] * du[t][i]);
        u[t][i] += by_u * du[t][i];
      }
    each([&](int t, int i, Wall& wall, Real sign) {
      wall.room += by_u * sign * du[t][i];
      wall.price += by_price * wall.change;
    });
  }

  void iterate() {
    Pack by_u, by_price;
    factor();
    step(Pack{}, false);
    longest(by_u, by_price);
    const Pack left = complementarity(by_u, by_price) / mean;
    step(left * left * left * mean, true);
    longest(by_u, by_price);
    move(least(KEPT * by_u, Pack{} + 1), least(KEPT * by_price, Pack{} + 1));
    mean = complementarity(Pack{}, Pack{});
  }

  // a bound is active where it is stiffer than the costs
  void tell_sides() {
    for (int t = 0; t < T; ++t)
      for (int i = 0; i < m; ++i) side[t][i] = this->tied(i) ? Pack{} + 1 : Pack{};
    each([&](int t, int i, Wall& wall, Real sign) {
      const Pack own = this->H_uu[P::cost_alike[t]][i * m + i];
      if (!this->tied(i)) side[t][i] = wall.price > wall.room * own ? Pack{} - sign : side[t][i];
    });
  }

  // goes on until the active sets of all lanes are told; `take()` is called where some are,
  // with the number of recursions before the guesses; the number of recursions
  template <class F>
  int interior(const Mask& wanted, int most_, F take) {
    const Real close = std::sqrt(std::numeric_limits<Real>::epsilon()) * Real(1e-3);
    Mask open = wanted;
    int used = 0;
    place();
    mean = complementarity(Pack{}, Pack{});
    for (int next = 0; used < most_ && any(open) && next < MOST; ++next) {
      const Mask waits = open & ~(mean < close * expected / Real(T * m));
      if (any(waits)) {
        iterate();
        ++used;
        continue;
      }
      Pack kept_u[T][m], kept_gradient[T][m];
      std::memcpy(kept_u, u, sizeof(kept_u));
      std::memcpy(kept_gradient, gradient, sizeof(kept_gradient));
      tell_sides();
      this->refactor(T - 1);
      const int before = used;
      used += this->pivot(GUESSES, GUESSES + 1);
      take(open & found, before);
      open &= ~found;
      if (!any(open)) break;
      std::memcpy(u, kept_u, sizeof(kept_u));
      std::memcpy(gradient, kept_gradient, sizeof(kept_gradient));
      iterate();
      ++used;
    }
    return used;
  }
};

}  // namespace dmmv
