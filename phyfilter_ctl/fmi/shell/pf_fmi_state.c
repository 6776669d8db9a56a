/* States of an instance: taken, put back, as bytes. See pf_fmi.h. */
#include <stdlib.h>
#include <string.h>

#include "pf_fmi.h"

enum { FORMAT = 1 };
#define MAGIC 0x7066666du /* also tells the byte order */

typedef struct { /* of the bytes */
  uint32_t magic, format;
  uint64_t size, token, checksum;
} header;

struct pf_fmi_state {
  pf_fmi_state *next;
  header head; /* the data follow */
};

static uint64_t digest(const void *bytes, size_t n) { /* FNV-1a */
  uint64_t hash = 14695981039346656037ull;
  for (size_t i = 0; i < n; i++) hash = (hash ^ ((const unsigned char *)bytes)[i]) * 1099511628211ull;
  return hash;
}

static char *data(pf_fmi_state *state) { return (char *)(state + 1); }

/* Only states that this instance has given out are looked into: anything else may be any pointer. */
static pf_fmi_state *known(pf_fmi *self, const void *pointer, const char *call) {
  pf_fmi_state *state = self->states;
  while (state && state != pointer) state = state->next;
  if (!state) pf_fmi_say(self, PF_FMI_ERROR, "%s: not a state of this instance", call);
  return state;
}

static pf_fmi_state *allocate(pf_fmi *self) {
  pf_fmi_state *const state = malloc(sizeof(pf_fmi_state) + self->saved_size);
  if (!state) {
    pf_fmi_say(self, PF_FMI_ERROR, "state: out of memory");
    return NULL;
  }
  state->head.magic = MAGIC;
  state->head.format = FORMAT;
  state->head.size = self->saved_size;
  state->head.token = digest(pf_fmu_here.token, strlen(pf_fmu_here.token));
  state->next = self->states;
  self->states = state;
  return state;
}

int pf_fmi_get_state(pf_fmi *self, void **pointer) {
  if (!pointer) return pf_fmi_say(self, PF_FMI_ERROR, "getFMUState: the argument is NULL");
  if (!pf_fmi_in(self, PF_FMI_ANY & ~(uint32_t)PF_FMI_INTERMEDIATE, "getFMUState")) return PF_FMI_ERROR;
  pf_fmi_state *const state = *pointer ? known(self, *pointer, "getFMUState") : allocate(self);
  if (!state) return PF_FMI_ERROR;
  memcpy(data(state), self->saved, self->saved_size);
  *pointer = state;
  return PF_FMI_OK;
}

int pf_fmi_set_state(pf_fmi *self, void *pointer) {
  if (!pf_fmi_in(self, PF_FMI_ANY & ~(uint32_t)PF_FMI_INTERMEDIATE, "setFMUState")) return PF_FMI_ERROR;
  pf_fmi_state *const state = known(self, pointer, "setFMUState");
  if (!state) return PF_FMI_ERROR;
  memcpy(self->saved, data(state), self->saved_size);
  self->fresh = 0;
  return PF_FMI_OK;
}

int pf_fmi_free_state(pf_fmi *self, void **pointer) {
  if (!pointer) return pf_fmi_say(self, PF_FMI_ERROR, "freeFMUState: the argument is NULL");
  if (!*pointer) return PF_FMI_OK;
  pf_fmi_state *const state = known(self, *pointer, "freeFMUState");
  if (!state) return PF_FMI_ERROR;
  pf_fmi_state **link = &self->states;
  while (*link != state) link = &(*link)->next;
  *link = state->next;
  free(state);
  *pointer = NULL;
  return PF_FMI_OK;
}

int pf_fmi_serialized_size(pf_fmi *self, void *pointer, size_t *size) {
  if (!size) return pf_fmi_say(self, PF_FMI_ERROR, "serializedFMUStateSize: the argument is NULL");
  if (!known(self, pointer, "serializedFMUStateSize")) return PF_FMI_ERROR;
  *size = sizeof(header) + self->saved_size;
  return PF_FMI_OK;
}

int pf_fmi_serialize(pf_fmi *self, void *pointer, void *bytes, size_t size) {
  pf_fmi_state *const state = known(self, pointer, "serializeFMUState");
  if (!state) return PF_FMI_ERROR;
  if (!bytes || size != sizeof(header) + self->saved_size)
    return pf_fmi_say(self, PF_FMI_ERROR, "serializeFMUState: expected %lu bytes, got %lu%s",
                      (unsigned long)(sizeof(header) + self->saved_size), (unsigned long)size, bytes ? "" : " at NULL");
  header head = state->head;
  head.checksum = digest(data(state), self->saved_size);
  memcpy(bytes, &head, sizeof head);
  memcpy((char *)bytes + sizeof head, data(state), self->saved_size);
  return PF_FMI_OK;
}

int pf_fmi_deserialize(pf_fmi *self, const void *bytes, size_t size, void **pointer) {
  header head;
  const char *why = NULL;
  if (!bytes || !pointer) return pf_fmi_say(self, PF_FMI_ERROR, "deserializeFMUState: an argument is NULL");
  if (size != sizeof head + self->saved_size)
    return pf_fmi_say(self, PF_FMI_ERROR, "deserializeFMUState: expected %lu bytes, got %lu",
                      (unsigned long)(sizeof head + self->saved_size), (unsigned long)size);
  const char *const content = (const char *)bytes + sizeof head;
  const pf_fmi_saved *const here = self->saved;
  pf_fmi_saved saved;
  memcpy(&head, bytes, sizeof head);
  memcpy(&saved, content, sizeof saved);
  if (head.magic != MAGIC || head.format != FORMAT || head.size != self->saved_size) why = "of another version";
  else if (head.token != digest(pf_fmu_here.token, strlen(pf_fmu_here.token))) why = "of another FMU";
  else if (head.checksum != digest(content, self->saved_size)) why = "damaged: the checksum differs";
  else if (saved.interface != here->interface || saved.event_mode != here->event_mode)
    why = "of an instance of another interface type";
  if (why) return pf_fmi_say(self, PF_FMI_ERROR, "deserializeFMUState: the state is %s", why);
  pf_fmi_state *const state = *pointer ? known(self, *pointer, "deserializeFMUState") : allocate(self);
  if (!state) return PF_FMI_ERROR;
  memcpy(data(state), content, self->saved_size);
  *pointer = state;
  return PF_FMI_OK;
}
