/* What the master's inner loop works on: structures that master_records.py fills, and the calls between its two files. */
#ifndef PF_MASTER_H
#define PF_MASTER_H
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { FLOAT64, FLOAT32, INT8, UINT8, INT16, UINT16, INT32, UINT32, INT64, UINT64, BOOLEAN2, BOOLEAN3 };
/* STUCK and RAISED: a callback into Python did, and Python knows what. */
enum { FINE, CALL_FAILED, OUT_OF_RANGE, STEP_TOO_SMALL, TERMINATED, NOT_FINITE, NO_THREADS, STUCK, RAISED };
enum { CALL_GET, CALL_SET, CALL_STEP, CALL_SAVE, CALL_RESTORE, CALL_SLOPES };
enum { STATUS_WARNING = 1, STATUS_DISCARD = 2, STATUS_FATAL = 4 };
enum { IN_PYTHON, LINEAR, FMI2, FMI3 };
/* Where a part ended the run; at the end of its step, its outputs there are still wanted. */
enum { RUNS, ENDED, ENDED_AT_END };
/* PY_STEP_BACK: a step from whose start or before a state may be put back. */
enum {
  PY_PUT, PY_GET, PY_STEP, PY_STEP_BACK, PY_SLOPES, PY_SAVE, PY_RESTORE, PY_FORGET, PY_TRANSITION, PY_OUTSIDE, PY_LOOP,
  PY_SETTLE
};
enum { SPANS = 8 }; /* lengths of steps that a linear part remembers */

typedef void (*Function)(void);

typedef struct {                /* variables of one type */
  int64_t type;
  Function get, set;
  const uint32_t *references;
  int64_t n_references, n;
  void *values;
  const int64_t *places;      /* in u or y */
} Group;

typedef struct {
  int64_t kind;
  void *instance;
  Function step, save, restore, forget, ended, told, slopes;
  Group *inputs, *outputs, *sloped;
  int64_t n_inputs, n_outputs, u_begin, u_end, y_begin, y_end;
  int64_t feedthrough, follows, changed, stale; /* follows: takes slopes; stale: inputs have moved since they were set */
  void *state;
  int64_t status, terminated, code;
  double reached;
  int64_t n_x;                /* LINEAR: x+ = rows [A B] of [x u], y = rows [C D] of [x u] */
  double *x, *saved_x, *work;
  const double *output;
  const int *orders;           /* of the derivatives that slopes are: all 1 */
  double *transitions, *spans; /* (SPANS, n_x, n_x + n_u), and of which step; 0: of none */
  int64_t slot;                /* to be filled next */
} Part;

typedef struct {                /* rows of a sparse matrix, and what is added */
  const int64_t *row, *column;
  const double *weight, *offset;
  const uint8_t *driven;
} Wires;

typedef struct {                /* inputs v = w(v), and the inverse of I - w' */
  int64_t n, ready;
  const int64_t *inputs;
  const uint8_t *real;        /* which may take any value */
  int64_t n_parts;
  const int64_t *parts;
  double *inverse, *v, *r, *step, *fresh, *left;
  double scale;
} Loop;

typedef struct {
  int64_t n_parts;
  Part *parts;
  const int64_t *sequence;    /* NULL: Jacobi */
  int64_t n_u, n_y;
  Wires wires, outside;
  int64_t n_outside, n_table, place, functions; /* functions: Python is asked what comes from outside */
  const double *table_t, *table; /* what comes from outside, linear in between */
  double *now, *base, *rate;     /* (n_outside) */
  int64_t passes, n_loops;
  Loop *loops;
  const uint8_t *held;           /* inputs on loops */
  int64_t settled_in_python, loops_in_python;
  double *u, *y, *v, *saved_u, *saved_y, *coarse;
  const uint8_t *watched; /* outputs that must be numbers */
  int64_t first;          /* hold of order one: inputs that `moves` says follow a line over a step */
  const uint8_t *moves;
  double *y_begin, *y_slope, *saved_slope, *u_slope;
  double rtol, atol, step, smallest;
  int64_t steps, rejected, threads;
  void *pool;
  int64_t (*python)(int64_t what, int64_t which, double t, double end);
  int64_t failed_part, failed_call, failed_place, failed_status; /* place: of the group, or in y */
  double failed_time;
} Master;

int64_t pf_master_failed(Master *m, int64_t part, int64_t call, int64_t place, int64_t status, double t);
int64_t pf_master_get(Master *m, int64_t p, double t);
int64_t pf_master_put(Master *m, int64_t p, double t);
int64_t pf_master_outside(Master *m, double t);
int64_t pf_master_wired(Master *m, double t, int64_t begin, int64_t end);
int64_t pf_master_aim(Master *m, int64_t p, double t, double end);
int64_t pf_master_settle(Master *m, double t);
#endif
