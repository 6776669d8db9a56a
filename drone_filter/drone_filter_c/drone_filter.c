#include "pf_ieee.h"

#include "drone_filter.h"

#define PF_NAME drone_filter
#include "pf_filter_code.h"

#include "pf_ieee.h" /* a table follows */
const drone_filter_params drone_filter_parameters = {
  .version = 1u,
  .crc = 0xfb5955b4u,
  .order = {1u},
  .dt = 0.002,
  .delay = 0.0,
  .a = {{8.177}},
  .b = {{8.177}},
  .poles = {{{-8.177, 0.0}}},
  .dA = {{{-0.01622099935984048}}},
  .equilibrium = {{1.0}},
  .C = {{1.0}},
};
