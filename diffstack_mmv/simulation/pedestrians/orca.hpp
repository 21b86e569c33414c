// ORCA for one agent after the other: half_planes.py and linear_program.py number by number, with the same rounding.
//
// To be compiled without fused operations. Positions come in the precision of the caller, all else is float.
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace orca {

constexpr float PARALLEL = 1e-5f;

struct Vector {
  float x, y;
};
inline Vector operator+(Vector a, Vector b) { return {a.x + b.x, a.y + b.y}; }
inline Vector operator-(Vector a, Vector b) { return {a.x - b.x, a.y - b.y}; }
inline Vector operator*(Vector a, float b) { return {a.x * b, a.y * b}; }
inline float dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y; }
inline float det(Vector a, Vector b) { return a.x * b.y - a.y * b.x; }
inline Vector normalised(Vector a) { return a * (1 / std::sqrt(dot(a, a))); }

struct Line {
  Vector point, direction;
  bool valid;
};
struct Interval {
  float left, right;
  bool feasible;
};
struct Optimum {
  Vector velocity;
  int failed;
};
struct Body {
  Vector position, velocity;
  float radius;
};
struct Rules {
  float distance, horizon_s, step_s;
  int most;
};

// the half-plane that a neighbor leaves to an agent
inline Line half_plane(const Body& agent, const Body& other, const Rules& rules) {
  const Vector offset = other.position - agent.position, relative = agent.velocity - other.velocity;
  const float radius = agent.radius + other.radius, squared = dot(offset, offset);
  const bool apart = squared > radius * radius;
  const float rate = 1 / (apart ? rules.horizon_s : rules.step_s);
  const Vector from_centre = relative - offset * rate;
  const float reach = dot(from_centre, from_centre), ahead = dot(from_centre, offset);
  if (!apart || (ahead < 0 && ahead * ahead > radius * radius * reach)) {
    const float length = std::sqrt(reach);
    const Vector unit = from_centre * (1 / length);
    const Vector change = unit * (radius * rate - length);
    return {agent.velocity + change * 0.5f, {unit.y, -unit.x}, true};
  }
  const float x = offset.x, y = offset.y, length = std::sqrt(squared - radius * radius);
  const Vector left = {x * length - y * radius, x * radius + y * length};
  const Vector right = {-(x * length + y * radius), -(-x * radius + y * length)};
  const Vector direction = (det(offset, from_centre) > 0 ? left : right) * (1 / squared);
  const Vector change = direction * dot(relative, direction) - relative;
  return {agent.velocity + change * 0.5f, direction, true};
}

// the permitted part of line i, inside of the disc of speeds and of the half-planes before it
inline Interval interval(const Line* lines, int i, float max_speed) {
  const Line& own = lines[i];
  const float infinity = std::numeric_limits<float>::infinity();
  const float middle = -dot(own.point, own.direction);
  const float discriminant = middle * middle + max_speed * max_speed - dot(own.point, own.point);
  const float half = std::sqrt(discriminant);
  float left = middle - half, right = middle + half, lower = -infinity, upper = infinity;
  bool shut_out = false;
  for (int j = 0; j < i; ++j) {
    if (!lines[j].valid) continue;
    const float denominator = det(own.direction, lines[j].direction);
    const float numerator = det(lines[j].direction, own.point - lines[j].point);
    if (std::fabs(denominator) <= PARALLEL) {
      shut_out = shut_out || numerator < 0;
      continue;
    }
    const float crossing = numerator / denominator;
    if (crossing != crossing) continue;
    if (denominator >= 0)
      upper = std::min(upper, crossing);
    else
      lower = std::max(lower, crossing);
  }
  left = left < lower ? lower : left;  // what is no number stays
  right = right > upper ? upper : right;
  return {left, right, !(discriminant < 0 || left > right || shut_out)};
}

// visits the lines in order; along(i, interval) is the optimum on line i
template <class F>
inline Optimum walk(const Line* lines, int count, float max_speed, Vector start, F along) {
  Vector velocity = start;
  for (int i = 0; i < count; ++i) {
    const Line& line = lines[i];
    if (!line.valid || !(det(line.direction, line.point - velocity) > 0)) continue;
    const Interval permitted = interval(lines, i, max_speed);
    if (!permitted.feasible) return {velocity, i};
    velocity = line.point + line.direction * along(line, permitted);
  }
  return {velocity, count};
}

inline Optimum nearest(const Line* lines, int count, float max_speed, Vector preferred) {
  const bool too_fast = dot(preferred, preferred) > max_speed * max_speed;
  const Vector start = too_fast ? normalised(preferred) * max_speed : preferred;
  return walk(lines, count, max_speed, start, [=](const Line& line, const Interval& permitted) {
    const float along = dot(line.direction, preferred - line.point);
    return along < permitted.left ? permitted.left : along > permitted.right ? permitted.right : along;
  });
}

inline Optimum furthest(const Line* lines, int count, float max_speed, Vector way) {
  return walk(lines, count, max_speed, way * max_speed, [=](const Line& line, const Interval& permitted) {
    return dot(way, line.direction) > 0 ? permitted.right : permitted.left;
  });
}

// the velocity that violates the worst half-plane least, where the program before has failed
inline Vector least_violation(const Line* lines, int count, float max_speed, Optimum found, Line* projected) {
  Vector velocity = found.velocity;
  float violation = 0;
  for (int i = found.failed; i < count; ++i) {
    const Line& own = lines[i];
    if (!own.valid || !(det(own.direction, own.point - velocity) > violation)) continue;
    for (int j = 0; j < i; ++j) {
      const Line& other = lines[j];
      const float determinant = det(own.direction, other.direction);
      const bool parallel = std::fabs(determinant) <= PARALLEL;
      const float shift = det(other.direction, own.point - other.point) / determinant;
      projected[j].point = parallel ? (own.point + other.point) * 0.5f : own.point + own.direction * shift;
      projected[j].direction = normalised(other.direction - own.direction);
      projected[j].valid = other.valid && !(parallel && dot(own.direction, other.direction) > 0);
    }
    const Optimum improved = furthest(projected, i, max_speed, {-own.direction.y, own.direction.x});
    if (improved.failed >= i) velocity = improved.velocity;
    violation = det(own.direction, own.point - velocity);
  }
  return velocity;
}

// all agents of one episode; T is the precision of the caller
template <class T>
struct Crowd {
  int agents, others;  // others: agents, and the robot where it is seen
  Rules rules;
  std::vector<Body> bodies;
  std::vector<Line> lines, projected;
  std::vector<std::pair<float, int>> order;

  Crowd(int agents_, bool robot, const Rules& rules_)
      : agents(agents_), others(agents_ + robot), rules(rules_), bodies(others), lines(others), projected(others) {}

  static Vector narrow(const T* a) { return {float(a[0]), float(a[1])}; }

  void place(int i, const T* position, const T* velocity, T radius, T margin) {
    bodies[i] = {narrow(position), narrow(velocity), float(radius + margin)};
  }

  // half-planes of the nearest of those that agent i sees; equal distances in their order
  int see(int i) {
    order.clear();
    for (int j = 0; j < others; ++j) {
      if (j == i) continue;
      const Vector offset = bodies[i].position - bodies[j].position;
      const float squared = dot(offset, offset);
      if (squared < rules.distance * rules.distance) order.emplace_back(squared, j);
    }
    std::stable_sort(order.begin(), order.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
    const int count = std::min<int>(order.size(), rules.most);
    for (int k = 0; k < count; ++k) lines[k] = half_plane(bodies[i], bodies[order[k].second], rules);
    return count;
  }

  Vector chosen(int count, float max_speed, Vector preferred) {
    const Optimum found = nearest(lines.data(), count, max_speed, preferred);
    return least_violation(lines.data(), count, max_speed, found, projected.data());
  }

  // 1 m/s to the goal, slower within the last metre
  static Vector towards(const T* position, const T* goal) {
    const T x = goal[0] - position[0], y = goal[1] - position[1], distance = std::sqrt(x * x + y * y);
    return distance > 1 ? Vector{float(x / distance), float(y / distance)} : Vector{float(x), float(y)};
  }
};

// positions (E, h, steps, 2) and velocities likewise after each step of dt; robot: position, velocity (E, 2), radius (E)
template <class T>
void roll(long episodes, int h, int steps, T dt, T margin, const Rules& rules, const T* position, const T* velocity,
          const T* goal, const T* radius, const T* max_speed, const T* robot_position, const T* robot_velocity,
          const T* robot_radius, T* positions, T* velocities) {
  Crowd<T> crowd(h, robot_position != nullptr, rules);
  std::vector<T> p(2 * h), v(2 * h), next(2 * h);
  for (long e = 0; e < episodes; ++e) {
    std::copy_n(position + 2 * h * e, 2 * h, p.begin());
    std::copy_n(velocity + 2 * h * e, 2 * h, v.begin());
    if (robot_position) crowd.place(h, robot_position + 2 * e, robot_velocity + 2 * e, robot_radius[e], margin);
    for (int t = 0; t < steps; ++t) {
      for (int i = 0; i < h; ++i) crowd.place(i, &p[2 * i], &v[2 * i], radius[e * h + i], margin);
      for (int i = 0; i < h; ++i) {
        const Vector preferred = crowd.towards(&p[2 * i], goal + 2 * (e * h + i));
        const Vector chosen = crowd.chosen(crowd.see(i), float(max_speed[e * h + i]), preferred);
        next[2 * i] = chosen.x;
        next[2 * i + 1] = chosen.y;
      }
      for (int i = 0; i < 2 * h; ++i) {
        v[i] = next[i];
        p[i] += v[i] * dt;
        const long at = 2 * ((e * h + i / 2) * steps + t) + i % 2;
        positions[at] = p[i];
        velocities[at] = v[i];
      }
    }
  }
}

// velocities (E, h, k, 2) that goals (E, h, k, 2) would lead to
template <class T>
void respond(long episodes, int h, int k, T margin, const Rules& rules, const T* position, const T* velocity,
             const T* radius, const T* max_speed, const T* goals, T* velocities) {
  Crowd<T> crowd(h, false, rules);
  for (long e = 0; e < episodes; ++e) {
    for (int i = 0; i < h; ++i)
      crowd.place(i, position + 2 * (e * h + i), velocity + 2 * (e * h + i), radius[e * h + i], margin);
    for (int i = 0; i < h; ++i) {
      const long agent = e * h + i;
      const int count = crowd.see(i);
      for (int g = 0; g < k; ++g) {
        const Vector preferred = crowd.towards(position + 2 * agent, goals + 2 * (agent * k + g));
        const Vector chosen = crowd.chosen(count, float(max_speed[agent]), preferred);
        velocities[2 * (agent * k + g)] = chosen.x;
        velocities[2 * (agent * k + g) + 1] = chosen.y;
      }
    }
  }
}

}  // namespace orca

#pragma GCC visibility push(default)
extern "C" {
#define ORCA_ENTRIES(NAME, T)                                                                                        \
  void orca_roll_##NAME(long episodes, int h, int steps, double dt, double margin, const orca::Rules* rules,          \
                        const T* position, const T* velocity, const T* goal, const T* radius, const T* max_speed,     \
                        const T* robot_position, const T* robot_velocity, const T* robot_radius, T* positions,        \
                        T* velocities) {                                                                             \
    orca::roll<T>(episodes, h, steps, T(dt), T(margin), *rules, position, velocity, goal, radius, max_speed,          \
                  robot_position, robot_velocity, robot_radius, positions, velocities);                              \
  }                                                                                                                  \
  void orca_respond_##NAME(long episodes, int h, int k, double margin, const orca::Rules* rules, const T* position,   \
                           const T* velocity, const T* radius, const T* max_speed, const T* goals, T* velocities) {  \
    orca::respond<T>(episodes, h, k, T(margin), *rules, position, velocity, radius, max_speed, goals, velocities);    \
  }
ORCA_ENTRIES(float, float)
ORCA_ENTRIES(double, double)
}
#pragma GCC visibility pop
