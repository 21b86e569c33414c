// What a program without Python sees; planner.h declares it.
#pragma GCC visibility push(default)
extern "C" {

const Real* dmmv_defaults(void) { return Exported::defaults; }

int dmmv_plan(const Real* parameters, const Real* state, const Real* guess, dmmv_plan_result* result) {
  long iterations = 0, status = 0;
  const dmmv::Settings settings = Exported::settings;
  dmmv_solve(1, 1, parameters, Exported::bounds, state, guess, &settings, &result->states[0][0], &result->controls[0][0],
             &result->cost, &result->residual, &iterations, &status);
  result->iterations = int(iterations);
  return int(status);
}

}  // extern "C"
#pragma GCC visibility pop
