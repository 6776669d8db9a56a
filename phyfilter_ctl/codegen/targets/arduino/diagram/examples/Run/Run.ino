// The diagram every @NAME@_STEP s, its outputs on the serial line.
#include <@name@.h>

static @name@ self;
static uint32_t last;

void setup() {
  Serial.begin(115200);
  if (@name@_init(&self)) Serial.println("refused: see pf_ieee.h");
  last = micros();
}

void loop() {
  pf_real u[@NAME@_N_U + 1] = {0}, y[@NAME@_N_Y + 1];  // u: your inputs
  const uint32_t period = (uint32_t)(1e6 * @NAME@_STEP + 0.5);  // us
  if (micros() - last < period) return;
  last += period;
  const int status = @name@_step(&self, u, y);
  for (int i = 0; i < @NAME@_N_Y; i++) {
    Serial.print((float)y[i], 6);
    Serial.print(' ');
  }
  Serial.println(status);
}
