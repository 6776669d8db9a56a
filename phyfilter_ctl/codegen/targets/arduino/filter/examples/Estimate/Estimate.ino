// The force on a body from its measured velocity, every @dt@ s, on the serial line.
#include <@name@_guard.h>

static @name@_guard guard;
static uint32_t last;

// Your sensor and your known force go here: g is @which_g@.
static void measure(@name@_real *x, @name@_real *g) {
  for (int i = 0; i < @name@_N_X; i++) x[i] = g[i] = 0;
}

void setup() {
  Serial.begin(115200);
  const int code = @name@_guard_init(&guard, &@name@_parameters);
  if (code) Serial.println(pf_filter_message(code));
  last = micros();
}

void loop() {
  @name@_real x[@name@_N_X], g[@name@_N_X], f_theta[@name@_N_F] = {0}, f_hat[@name@_N_F];
  static uint64_t now;
  const uint32_t time = micros();
  if (time - last < @period_us@u) return;
  now += time - last;  // 64 bits: micros() starts again after 71 minutes
  last = time;
  measure(x, g);
  const uint32_t health = @name@_guard_step(&guard, now, x, g, f_theta, NULL, f_hat);
  for (int i = 0; i < @name@_N_F; i++) {
    Serial.print((float)f_hat[i], 6);
    Serial.print(' ');
  }
  Serial.println((unsigned long)health);
}
