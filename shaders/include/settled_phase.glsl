// Finds out which phase of the cycle of jitter this frame has: which of the last PHASES different sets of the host's
// parameters. One invocation.
//
// Kept: the phase whose place is taken next, this frame's, and if it is new; then of each phase a 1 and its parameters.
layout(local_size_x = 1) in;

layout(set = 0, binding = FREE_BINDING, std430) buffer Kept { uint d[]; } kept;
#if PARAMS > 0
layout(push_constant, std430) uniform Params { uint all_params[PARAM_WORDS]; };
const uint kPlaces[PARAMS] = uint[PARAMS](PARAM_PLACES);
uint param(uint i) { return all_params[kPlaces[i]]; }
#else
uint param(uint i) { return 0u; }
#endif

uint place(uint phase) { return 3u + phase * (PARAMS + 1u); }

void main() {
  uint found = PHASES;
  for (uint phase = 0u; phase < PHASES; ++phase) {
    uint difference = kept.d[place(phase)] ^ 1u;
    for (uint i = 0u; i < PARAMS; ++i) difference |= kept.d[place(phase) + 1u + i] ^ param(i);
    if (difference == 0u) found = phase;
  }
  bool is_new = found == PHASES;
  if (is_new) {
    found = kept.d[0];
    kept.d[0] = (found + 1u) % PHASES;
    kept.d[place(found)] = 1u;
    for (uint i = 0u; i < PARAMS; ++i) kept.d[place(found) + 1u + i] = param(i);
  }
  kept.d[1] = found;
  kept.d[2] = is_new ? 1u : 0u;
}
