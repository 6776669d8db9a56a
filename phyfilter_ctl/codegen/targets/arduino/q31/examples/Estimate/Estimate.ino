// The force on a body from its measured velocity, every @dt@ s, in integers, on the serial line.
#include <@name@.h>

static @name@ filter;
static uint32_t last;

// Your sensor and your known force go here, g is @which_g@: integers with @name@_X_FRACTION and @name@_G_FRACTION fractional bits.
static void measure(int32_t *x, int32_t *g) {
  for (int i = 0; i < @name@_N; i++) x[i] = g[i] = 0;
}

void setup() {
  Serial.begin(115200);
  const int code = @name@_init(&filter, &@name@_parameters);
  if (code) Serial.println(code);
  last = micros();
}

void loop() {
  int32_t x[@name@_N], g[@name@_N], f_theta[@name@_N] = {0}, f_hat[@name@_N];
  if (micros() - last < @period_us@u) return;
  last += @period_us@u;
  measure(x, g);
  const int flags = @name@_step(&filter, x, g, f_theta, f_hat);
  for (int i = 0; i < @name@_N; i++) {
    Serial.print((long)f_hat[i]);
    Serial.print(' ');
  }
  Serial.println(flags);
}
