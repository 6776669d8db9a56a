/* What the FMI 2 and FMI 3 front ends share: an instance of a pf_model with variables by reference, modes, logging,
 * states, derivatives and co-simulation steps.
 *
 * An instance is one allocation: this struct, then what a state holds (pf_fmi_saved, the model, input slopes), then
 * scratch memory. No call but instantiation and the taking of states allocates. A call that is refused logs why and
 * changes nothing. Status values are those of both standards: 0 OK, 1 Warning, 2 Discard, 3 Error.
 */
#ifndef PF_FMI_H
#define PF_FMI_H
#include <stdint.h>

#include "pf_model.h"
#include "pf_run.h"

enum { PF_FMI_OK = 0, PF_FMI_WARNING = 1, PF_FMI_DISCARD = 2, PF_FMI_ERROR = 3 };

enum { PF_FMI_MODEL_EXCHANGE = 1, PF_FMI_CO_SIMULATION = 2 };

enum { /* modes, one bit each so that sets of them are masks */
  PF_FMI_INSTANTIATED = 1,
  PF_FMI_INITIALIZATION = 2,
  PF_FMI_EVENT = 4,
  PF_FMI_CONTINUOUS = 8,
  PF_FMI_STEP = 16,
  PF_FMI_INTERMEDIATE = 32,
  PF_FMI_TERMINATED = 64,
  PF_FMI_CONFIGURATION = 128
};
#define PF_FMI_BEFORE (PF_FMI_INSTANTIATED | PF_FMI_INITIALIZATION)
#define PF_FMI_RUNNING (PF_FMI_EVENT | PF_FMI_CONTINUOUS | PF_FMI_STEP)
#define PF_FMI_ANY (PF_FMI_BEFORE | PF_FMI_RUNNING | PF_FMI_INTERMEDIATE | PF_FMI_TERMINATED)

typedef enum {
  PF_FMI_TIME,
  PF_FMI_INPUT,
  PF_FMI_OUTPUT,
  PF_FMI_PARAMETER,
  PF_FMI_FIXED, /* a parameter that cannot change while running */
  PF_FMI_STATE,
  PF_FMI_DERIVATIVE,
  PF_FMI_SAMPLED,
  PF_FMI_CONDITION, /* of an event, what event indicators are */
  PF_FMI_CLOCK,
  PF_FMI_SOLVER_STEP,
  PF_FMI_SOLVER_RTOL,
  PF_FMI_SOLVER_ATOL,
  PF_FMI_STRUCTURE, /* the number of channels */
  PF_FMI_KINDS
} pf_fmi_kind;

typedef struct { /* the variable with value reference i is entry i; there is none with reference 0 */
  uint32_t kind, first, count;
  uint32_t each; /* scalars of each channel; 0: there are `count`, however many channels there are */
} pf_fmi_variable;

typedef struct { /* of a sampled block: what the importer ticks it with */
  const char *name;
  pf_time period;
  uint64_t counter, resolution; /* period = counter / resolution; 0: no such fraction is the same number */
} pf_fmi_clock;

struct pf_fmi;

typedef struct { /* numbers of one instance at fixed addresses, for a calibration tool: see pf_fmi_xcp.c */
  double *values, *seen, *in_force; /* what the tool sees; what of that is known; of parameters, those in force */
  struct pf_fmi *owner;
  void (*claim)(struct pf_fmi *), (*take)(struct pf_fmi *), (*show)(struct pf_fmi *), (*leave)(struct pf_fmi *);
} pf_fmi_page;

typedef struct { /* generated for each FMU */
  const pf_model *model;
  const char *token;
  int kinds;                          /* PF_FMI_MODEL_EXCHANGE | PF_FMI_CO_SIMULATION */
  const pf_fmi_variable *variables;
  uint32_t n_variables;
  uint32_t channels, most_channels;   /* at first and at most: the model has room for these; 0: their number is fixed */
  const char *const *inputs;          /* names, for messages */
  pf_solver solver;
  pf_time communication;              /* nominal interval of pf_model.update; 0: there is none */
  pf_time longest_step;               /* of a communication step: more would never end */
  int accept_bad_inputs;              /* inputs that are not finite are the model's affair */
  const uint32_t *rows, *columns;     /* dependencies of (x', y) on (x, u), compressed rows */
  const pf_real *nominals;            /* of the continuous states; NULL: all 1 */
  const pf_fmi_clock *clocks;         /* of the model's tasks; NULL: they follow time events */
  pf_fmi_page *page;                  /* NULL: there is none */
  const char *(*why)(void);           /* why the model refused the last call of this thread; NULL: codes say it all */
} pf_fmu;

extern const pf_fmu pf_fmu_here;

static inline int pf_fmi_exists(uint32_t reference) { return reference - 1U < pf_fmu_here.n_variables; }

typedef struct { /* of the mutable data, what the model does not hold itself; no pointers */
  uint32_t mode, interface, stop_defined, event_mode, early_return;
  uint32_t staged; /* parameters were set that are not in force yet */
  uint32_t sloped; /* input slopes were set for the next step */
  uint32_t ticked; /* clocks have been set: sampled blocks wait for them */
  uint32_t channels; /* in use; the others rest at zero */
  pf_time time, start, stop;
  pf_time last_event; /* where the last instants ran */
  pf_time ticks;      /* model exchange with pf_model.update: updates so far */
  pf_solver solver;
} pf_fmi_saved;

typedef struct pf_fmi_state pf_fmi_state;

typedef struct pf_fmi {
  const pf_model *model;
  pf_fmi_saved *saved;
  char *self, *spare;            /* the model and a copy: of before a step, or for looking ahead */
  size_t saved_size;             /* of saved, model, slopes and active together */
  pf_real *u, *x, *slopes, *work, *y, *dx, *s, *g, *seed, *result;
  unsigned char *active;         /* clocks that tick in this event */
  pf_real *values[PF_FMI_KINDS]; /* by kind */
  uint32_t fresh;                /* bit of each kind whose values are up to date */
  uint32_t categories;           /* bit 0: events are logged */
  pf_fmi_state *states;          /* those given out */
  void *environment;
  void (*callback)(void);        /* the importer's log function */
  void (*log)(struct pf_fmi *self, int status, const char *category, const char *message);
  void (*intermediate)(void);    /* FMI 3 */
  int (*pause)(struct pf_fmi *self, pf_time t, pf_time *until); /* calls it; 1: return early at *until */
  char *name;
} pf_fmi;

pf_fmi *pf_fmi_new(const char *name, const char *token, int interface, void (*callback)(void), void *environment,
                   void (*log)(pf_fmi *, int, const char *, const char *));
void pf_fmi_delete(pf_fmi *self);
void pf_fmi_reset(pf_fmi *self);

/* Logs and gives the status back. */
int pf_fmi_say(pf_fmi *self, int status, const char *format, ...);
void pf_fmi_event(pf_fmi *self, const char *format, ...);
int pf_fmi_log_categories(pf_fmi *self, int on, size_t n, const char *const *categories);
/* 1 where the instance is in one of the modes; else logs. */
int pf_fmi_in(pf_fmi *self, uint32_t modes, const char *call);

/* Scalars of a variable, and continuous states, of the channels in use. */
uint32_t pf_fmi_count(const pf_fmi *self, pf_fmi_variable variable);
size_t pf_fmi_n_x(const pf_fmi *self);

/* For the parts of the shell. */
char *pf_fmi_view(pf_fmi *self);
int pf_fmi_bad_input(const pf_fmi *self);
int pf_fmi_failure(pf_fmi *self, const char *call, int code);

int pf_fmi_get(pf_fmi *self, const uint32_t *references, size_t n, double *values, size_t n_values);
int pf_fmi_set(pf_fmi *self, const uint32_t *references, size_t n, const double *values, size_t n_values);
int pf_fmi_get_sizes(pf_fmi *self, const uint32_t *references, size_t n, uint64_t *values, size_t n_values);
int pf_fmi_set_sizes(pf_fmi *self, const uint32_t *references, size_t n, const uint64_t *values, size_t n_values);
int pf_fmi_set_slopes(pf_fmi *self, const uint32_t *references, size_t n, const int *orders, const double *values);

/* Of pf_fmi_page: by instantiation, before parameters come into force, after a step or an event, at the end. */
void pf_fmi_page_claim(pf_fmi *self);
void pf_fmi_page_take(pf_fmi *self);
void pf_fmi_page_show(pf_fmi *self);
void pf_fmi_page_leave(pf_fmi *self);

/* NULL where it is none, which is logged. */
const pf_fmi_clock *pf_fmi_clock_of(pf_fmi *self, uint32_t reference, const char *call);
int pf_fmi_get_clocks(pf_fmi *self, const uint32_t *references, size_t n, _Bool *values);
int pf_fmi_set_clocks(pf_fmi *self, const uint32_t *references, size_t n, const _Bool *values);
int pf_fmi_ticking(const pf_fmi *self);     /* whether one is active */
int pf_fmi_check_ticks(pf_fmi *self);       /* an error where one was forgotten */
void pf_fmi_end_ticks(pf_fmi *self);

int pf_fmi_enter_initialization(pf_fmi *self, int tolerance_defined, double tolerance, double start, int stop_defined,
                                double stop);
int pf_fmi_exit_initialization(pf_fmi *self);
int pf_fmi_update_discrete(pf_fmi *self, int *states_changed, int *next_defined, double *next);
int pf_fmi_set_time(pf_fmi *self, double t);
int pf_fmi_set_states(pf_fmi *self, const double *x, size_t n);
int pf_fmi_get_states(pf_fmi *self, double *x, size_t n);
int pf_fmi_get_derivatives(pf_fmi *self, double *dx, size_t n);
int pf_fmi_indicators(pf_fmi *self, double *indicators, size_t n);
int pf_fmi_completed_step(pf_fmi *self, int *event);
int pf_fmi_nominals(pf_fmi *self, double *nominals, size_t n);

/* One communication step; *reached and *event also where it ends early. */
int pf_fmi_step(pf_fmi *self, double t, double h, double *reached, int *event);

int pf_fmi_directional(pf_fmi *self, const uint32_t *unknowns, size_t n_unknowns, const uint32_t *knowns,
                       size_t n_knowns, const double *seed, size_t n_seed, double *result, size_t n_result);
int pf_fmi_adjoint(pf_fmi *self, const uint32_t *unknowns, size_t n_unknowns, const uint32_t *knowns, size_t n_knowns,
                   const double *seed, size_t n_seed, double *result, size_t n_result);
int pf_fmi_dependencies(pf_fmi *self, uint32_t reference, size_t *n);
int pf_fmi_dependency(pf_fmi *self, uint32_t reference, size_t *dependent_elements, uint32_t *independents,
                      size_t *independent_elements, size_t n);

int pf_fmi_get_state(pf_fmi *self, void **state);
int pf_fmi_set_state(pf_fmi *self, void *state);
int pf_fmi_free_state(pf_fmi *self, void **state);
int pf_fmi_serialized_size(pf_fmi *self, void *state, size_t *size);
int pf_fmi_serialize(pf_fmi *self, void *state, void *bytes, size_t size);
int pf_fmi_deserialize(pf_fmi *self, const void *bytes, size_t size, void **state);

#endif
