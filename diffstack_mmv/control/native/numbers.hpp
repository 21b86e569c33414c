// Numbers of the generated code: plain ones, packs of eight, and either with derivatives.
#pragma once
#include <cmath>
#include <cstring>
#include <limits>

namespace dmmv {

using std::size_t;

constexpr int LANES = 8;

template <class T>
struct PackOf {
  typedef T type __attribute__((vector_size(sizeof(T) * LANES)));
};
using Pack = PackOf<Real>::type;
using Mask = decltype(Pack{} < Pack{});

// value and derivative along one direction (D = Real) or eight (D = Pack)
template <class D>
struct Dual {
  Real v;
  D d;
};

// a value in each lane, and its derivative along a direction of its own
struct Directed {
  Pack v, d;
};

template <class V>
struct Truth {
  using type = bool;
};
template <>
struct Truth<Pack> {
  using type = Mask;
};
template <>
struct Truth<Directed> {
  using type = Mask;
};
template <class V>
using TruthOf = typename Truth<V>::type;

// plain numbers in the place of others
template <class V>
inline V lift(Real a) {
  if constexpr (std::is_same_v<V, Real>) {
    return a;
  } else if constexpr (std::is_same_v<V, Pack>) {
    return Pack{} + a;
  } else if constexpr (std::is_same_v<V, Directed>) {
    return {Pack{} + a, Pack{}};
  } else {
    return V{a, {}};
  }
}
template <class V>
inline V lift(const V& a)
  requires(!std::is_same_v<V, Real>)
{
  return a;
}

// arithmetic of duals
template <class D> inline Dual<D> operator+(const Dual<D>& a, const Dual<D>& b) { return {a.v + b.v, a.d + b.d}; }
template <class D> inline Dual<D> operator+(const Dual<D>& a, Real b) { return {a.v + b, a.d}; }
template <class D> inline Dual<D> operator+(Real a, const Dual<D>& b) { return {a + b.v, b.d}; }
template <class D> inline Dual<D> operator-(const Dual<D>& a, const Dual<D>& b) { return {a.v - b.v, a.d - b.d}; }
template <class D> inline Dual<D> operator-(const Dual<D>& a, Real b) { return {a.v - b, a.d}; }
template <class D> inline Dual<D> operator-(Real a, const Dual<D>& b) { return {a - b.v, -b.d}; }
template <class D> inline Dual<D> operator-(const Dual<D>& a) { return {-a.v, -a.d}; }
template <class D> inline Dual<D> operator*(const Dual<D>& a, const Dual<D>& b) { return {a.v * b.v, a.d * b.v + b.d * a.v}; }
template <class D> inline Dual<D> operator*(const Dual<D>& a, Real b) { return {a.v * b, a.d * b}; }
template <class D> inline Dual<D> operator*(Real a, const Dual<D>& b) { return {a * b.v, b.d * a}; }
template <class D> inline Dual<D> operator/(const Dual<D>& a, const Dual<D>& b) {
  const Real inverse = Real(1) / b.v, value = a.v / b.v;
  return {value, (a.d - b.d * value) * inverse};
}
template <class D> inline Dual<D> operator/(const Dual<D>& a, Real b) { return {a.v / b, a.d * (Real(1) / b)}; }
template <class D> inline Dual<D> operator/(Real a, const Dual<D>& b) {
  const Real inverse = Real(1) / b.v, value = a / b.v;
  return {value, b.d * (-value * inverse)};
}

inline Directed operator+(const Directed& a, const Directed& b) { return {a.v + b.v, a.d + b.d}; }
inline Directed operator+(const Directed& a, Real b) { return {a.v + b, a.d}; }
inline Directed operator+(Real a, const Directed& b) { return {a + b.v, b.d}; }
inline Directed operator-(const Directed& a, const Directed& b) { return {a.v - b.v, a.d - b.d}; }
inline Directed operator-(const Directed& a, Real b) { return {a.v - b, a.d}; }
inline Directed operator-(Real a, const Directed& b) { return {a - b.v, -b.d}; }
inline Directed operator-(const Directed& a) { return {-a.v, -a.d}; }
inline Directed operator*(const Directed& a, const Directed& b) { return {a.v * b.v, a.d * b.v + b.d * a.v}; }
inline Directed operator*(const Directed& a, Real b) { return {a.v * b, a.d * b}; }
inline Directed operator*(Real a, const Directed& b) { return {a * b.v, b.d * a}; }
inline Directed operator/(const Directed& a, const Directed& b) {
  const Pack inverse = Real(1) / b.v, value = a.v / b.v;
  return {value, (a.d - b.d * value) * inverse};
}
inline Directed operator/(const Directed& a, Real b) { return {a.v / b, a.d * (Real(1) / b)}; }
inline Directed operator/(Real a, const Directed& b) {
  const Pack inverse = Real(1) / b.v, value = a / b.v;
  return {value, b.d * (-value * inverse)};
}
// f of each lane
template <class F>
inline Directed by_lane(F f, const Directed& a, const Directed& b) {
  Directed r;
  for (int i = 0; i < LANES; ++i) {
    const Dual<Real> each = f(Dual<Real>{a.v[i], a.d[i]}, Dual<Real>{b.v[i], b.d[i]});
    r.v[i] = each.v;
    r.d[i] = each.d;
  }
  return r;
}

template <class V> inline Real bare(const V& a) { return a; }
template <class D> inline Real bare(const Dual<D>& a) { return a.v; }

// comparisons: of packs lane by lane, of all else by their values
#define DMMV_COMPARE(NAME, SIGN)                                            \
  inline bool NAME(Real a, Real b) { return a SIGN b; }                     \
  inline Mask NAME(const Pack& a, const Pack& b) { return a SIGN b; }       \
  inline Mask NAME(const Pack& a, Real b) { return a SIGN (Pack{} + b); }   \
  inline Mask NAME(Real a, const Pack& b) { return (Pack{} + a) SIGN b; }   \
  template <class D> inline bool NAME(const Dual<D>& a, const Dual<D>& b) { return a.v SIGN b.v; } \
  template <class D> inline bool NAME(const Dual<D>& a, Real b) { return a.v SIGN b; }             \
  template <class D> inline bool NAME(Real a, const Dual<D>& b) { return a SIGN b.v; }                  \
  inline Mask NAME(const Directed& a, const Directed& b) { return a.v SIGN b.v; }                       \
  inline Mask NAME(const Directed& a, Real b) { return a.v SIGN (Pack{} + b); }                         \
  inline Mask NAME(Real a, const Directed& b) { return (Pack{} + a) SIGN b.v; }
DMMV_COMPARE(op_lt, <)
DMMV_COMPARE(op_le, <=)
DMMV_COMPARE(op_gt, >)
DMMV_COMPARE(op_ge, >=)
DMMV_COMPARE(op_eq, ==)
DMMV_COMPARE(op_ne, !=)
#undef DMMV_COMPARE

inline bool op_and(bool a, bool b) { return a && b; }
inline Mask op_and(const Mask& a, const Mask& b) { return a & b; }
inline Mask op_and(bool a, const Mask& b) { return a ? b : Mask{}; }
inline Mask op_and(const Mask& a, bool b) { return op_and(b, a); }
inline bool op_or(bool a, bool b) { return a || b; }
inline Mask op_or(const Mask& a, const Mask& b) { return a | b; }
inline Mask op_or(bool a, const Mask& b) { return a ? ~Mask{} : b; }
inline Mask op_or(const Mask& a, bool b) { return op_or(b, a); }
inline bool op_not(bool a) { return !a; }
inline Mask op_not(const Mask& a) { return ~a; }

template <class V> inline V choose(bool c, const V& a, const V& b) { return c ? a : b; }
inline Pack choose(const Mask& c, const Pack& a, const Pack& b) { return c ? a : b; }
inline Directed choose(const Mask& c, const Directed& a, const Directed& b) { return {c ? a.v : b.v, c ? a.d : b.d}; }

// the larger and the smaller one; what is no number is passed on
template <class V> inline V op_max(const V& a, const V& b) {
  return choose(op_or(op_gt(a, b), op_ne(a, a)), a, b);
}
template <class V> inline V op_min(const V& a, const V& b) {
  return choose(op_or(op_lt(a, b), op_ne(a, a)), a, b);
}
template <class D> inline Dual<D> shared(const Dual<D>& a, const Dual<D>& b, const Dual<D>& other) {
  return a.v == b.v ? Dual<D>{a.v, (a.d + b.d) * Real(0.5)} : other;
}
template <class D> inline Dual<D> op_max(const Dual<D>& a, const Dual<D>& b) {
  return shared(a, b, choose(a.v > b.v || a.v != a.v, a, b));
}
template <class D> inline Dual<D> op_min(const Dual<D>& a, const Dual<D>& b) {
  return shared(a, b, choose(a.v < b.v || a.v != a.v, a, b));
}

inline Directed op_max(const Directed& a, const Directed& b) {
  return by_lane([](auto x, auto y) { return op_max(x, y); }, a, b);
}
inline Directed op_min(const Directed& a, const Directed& b) {
  return by_lane([](auto x, auto y) { return op_min(x, y); }, a, b);
}

template <class F> inline Pack each(const Pack& a, F f) {
  Pack r;
  for (int i = 0; i < LANES; ++i) r[i] = f(a[i]);
  return r;
}
template <class D> inline Dual<D> chain(const Dual<D>& a, Real value, Real slope) { return {value, a.d * slope}; }

// NAME(a), and its derivative in terms of the argument `a` and the value `y`
#define DMMV_UNARY(NAME, FUNCTION, SLOPE)                                               \
  inline Real NAME(Real a) { return FUNCTION(a); }                                      \
  inline Pack NAME(const Pack& a) { return each(a, [](Real x) { return Real(FUNCTION(x)); }); } \
  template <class D> inline Dual<D> NAME(const Dual<D>& x) {                            \
    const Real a = x.v, y = FUNCTION(a);                                                \
    (void)a; (void)y;                                                                   \
    return chain(x, y, SLOPE);                                                          \
  }                                                                                     \
  inline Directed NAME(const Directed& x) {                                             \
    return by_lane([](auto each, auto) { return NAME(each); }, x, x);                   \
  }
inline Real sign_of(Real a) { return a > 0 ? Real(1) : a < 0 ? Real(-1) : a; }
DMMV_UNARY(op_abs, std::fabs, sign_of(a))
DMMV_UNARY(op_sign, sign_of, Real(0))
DMMV_UNARY(op_sqrt, std::sqrt, Real(0.5) / y)
DMMV_UNARY(op_exp, std::exp, y)
DMMV_UNARY(op_log, std::log, Real(1) / a)
DMMV_UNARY(op_sin, std::sin, std::cos(a))
DMMV_UNARY(op_cos, std::cos, -std::sin(a))
DMMV_UNARY(op_tan, std::tan, Real(1) + y * y)
DMMV_UNARY(op_atan, std::atan, Real(1) / (Real(1) + a * a))
DMMV_UNARY(op_asin, std::asin, Real(1) / std::sqrt(Real(1) - a * a))
DMMV_UNARY(op_acos, std::acos, Real(-1) / std::sqrt(Real(1) - a * a))
DMMV_UNARY(op_sinh, std::sinh, std::cosh(a))
DMMV_UNARY(op_cosh, std::cosh, std::sinh(a))
DMMV_UNARY(op_tanh, std::tanh, Real(1) - y * y)
DMMV_UNARY(op_log1p, std::log1p, Real(1) / (Real(1) + a))
DMMV_UNARY(op_expm1, std::expm1, Real(1) + y)
DMMV_UNARY(op_erf, std::erf, Real(1.1283791670955126) * std::exp(-a * a))
DMMV_UNARY(op_floor, std::floor, Real(0))
DMMV_UNARY(op_ceil, std::ceil, Real(0))
#undef DMMV_UNARY

inline Real op_pow(Real a, Real b) { return std::pow(a, b); }
inline Pack op_pow(const Pack& a, const Pack& b) {
  Pack r;
  for (int i = 0; i < LANES; ++i) r[i] = std::pow(a[i], b[i]);
  return r;
}
template <class D> inline Dual<D> op_pow(const Dual<D>& a, const Dual<D>& b) {
  const Real y = std::pow(a.v, b.v);
  const Real by_b = y == 0 ? Real(0) : y * std::log(a.v);
  D d = a.d * (b.v * std::pow(a.v, b.v - 1));
  if constexpr (std::is_same_v<D, Real>) {
    if (b.d != 0) d = d + b.d * by_b;
  } else {
    for (int i = 0; i < LANES; ++i) if (b.d[i] != 0) d[i] += b.d[i] * by_b;
  }
  return {y, d};
}
inline Real op_atan2(Real a, Real b) { return std::atan2(a, b); }
inline Pack op_atan2(const Pack& a, const Pack& b) {
  Pack r;
  for (int i = 0; i < LANES; ++i) r[i] = std::atan2(a[i], b[i]);
  return r;
}
template <class D> inline Dual<D> op_atan2(const Dual<D>& a, const Dual<D>& b) {
  const Real square = a.v * a.v + b.v * b.v;
  return {std::atan2(a.v, b.v), (a.d * b.v - b.d * a.v) / square};
}
inline Real op_fmod(Real a, Real b) { return std::fmod(a, b); }
inline Pack op_fmod(const Pack& a, const Pack& b) {
  Pack r;
  for (int i = 0; i < LANES; ++i) r[i] = std::fmod(a[i], b[i]);
  return r;
}
template <class D> inline Dual<D> op_fmod(const Dual<D>& a, const Dual<D>& b) { return {std::fmod(a.v, b.v), a.d}; }
inline Directed op_pow(const Directed& a, const Directed& b) {
  return by_lane([](auto x, auto y) { return op_pow(x, y); }, a, b);
}
inline Directed op_atan2(const Directed& a, const Directed& b) {
  return by_lane([](auto x, auto y) { return op_atan2(x, y); }, a, b);
}
inline Directed op_fmod(const Directed& a, const Directed& b) {
  return by_lane([](auto x, auto y) { return op_fmod(x, y); }, a, b);
}

}  // namespace dmmv
