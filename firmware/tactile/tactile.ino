// Three touch-sensitive fixels on an Arduino Mega 2560, asked over its serial port at 115200 baud.
//
// Any byte is a request and is answered by one byte, a bit a fixel, as in the thesis the bench
// comes from (Experimental Calibration, appendix C.2). Some sequences of bytes are requests of a
// second kind, answered by a frame with a time stamp and a checksum; README.md has the table.

#include <avr/sleep.h>
#include <util/crc16.h>

const uint8_t SENSORS = 3;
const uint8_t PIN_OF_BIT[SENSORS] = {A2, A0, A1};  // bit 0 blue, bit 1 red, bit 2 green
uint16_t threshold[SENSORS] = {900, 900, 900};     // of 1023; above it, the fixel is touched

const uint16_t LARGEST = 1023;                     // that the converter gives: 5 V

const uint8_t PROTOCOL = 2;
const uint8_t REQUEST = 0xF5;  // begins a request
const uint8_t REPLY = 0xFA;    // begins an answer; an old answer is never above 7
const uint8_t ENVELOPE = 5;    // bytes of a request beside its values: begin, kind, number, checksum
const uint8_t LONGEST = ENVELOPE + 2 * SENSORS;
const unsigned long PATIENCE_MS = 5;  // a request that pauses for longer is none

uint8_t held[LONGEST];  // what may become a request
uint8_t n_held = 0;
unsigned long last_byte_ms;

void setup() {
  set_sleep_mode(SLEEP_MODE_IDLE);
  // Nothing is sent unasked: an old program would take a greeting for tactile bytes.
  Serial.begin(115200);
}

void loop() {
  if (Serial.available() > 0) {
    held[n_held++] = Serial.read();
    last_byte_ms = millis();
    sort_out_held();
  } else if (n_held > 0 && millis() - last_byte_ms > PATIENCE_MS) {
    answer_oldest_as_before();
    sort_out_held();
  } else {
    sleep_until_something_happens();
  }
}

// --- requests ---------------------------------------------------------------------------------

// Obey a complete request; answer with an old byte whatever cannot become one.
void sort_out_held() {
  while (n_held > 0) {
    const uint8_t length = n_held < 2 ? 0 : request_length(held[1]);
    const bool possible = held[0] == REQUEST && (n_held < 2 || length > 0);
    if (possible && (n_held < 2 || n_held < length)) return;  // more is to come
    if (possible && checksum(held + 1, length - 3) == word_at(held + length - 2)) {
      obey(held[1], held[2], held + 3);
      drop(length);
    } else {
      answer_oldest_as_before();
    }
  }
}

uint8_t request_length(uint8_t kind) {
  if (kind == 'I' || kind == 'R') return ENVELOPE;
  if (kind == 'T') return LONGEST;
  return 0;
}

void answer_oldest_as_before() {
  uint16_t value[SENSORS];
  Serial.write(touched(value));
  drop(1);
}

// What stands behind may be the next request.
void drop(uint8_t count) {
  n_held -= count;
  memmove(held, held + count, n_held);
}

void obey(uint8_t kind, uint8_t number, const uint8_t* values) {
  if (kind == 'R') {
    send_reading(number);
  } else {
    if (kind == 'T') set_thresholds(values);
    send_identity(kind, number);  // with the thresholds that are in force
  }
}

// All three, or none where one is above what the converter can give: that fixel would be deaf.
void set_thresholds(const uint8_t* values) {
  for (uint8_t bit = 0; bit < SENSORS; ++bit) {
    if (word_at(values + 2 * bit) > LARGEST) return;
  }
  memcpy(threshold, values, sizeof threshold);
}

// --- answers ----------------------------------------------------------------------------------

// The bits, and what the converter saw in the order of the bits; 0.34 ms.
uint8_t touched(uint16_t* value) {
  uint8_t bits = 0;
  for (uint8_t bit = 0; bit < SENSORS; ++bit) {
    value[bit] = analogRead(PIN_OF_BIT[bit]);
    if (value[bit] > threshold[bit]) bits |= 1 << bit;
  }
  return bits;
}

// Little-endian and without gaps: that is how an AVR keeps it.
struct Reading {
  uint8_t protocol;
  uint8_t bits;
  uint32_t time_us;  // when the first sensor was about to be read; wraps after 71.6 minutes
  uint16_t value[SENSORS];
};

struct Identity {
  uint8_t protocol;
  uint8_t sensors;
  uint16_t threshold[SENSORS];
  uint32_t uptime_ms;
  char name[13];
};

void send_reading(uint8_t number) {
  Reading reading;
  reading.protocol = PROTOCOL;
  reading.time_us = micros();
  reading.bits = touched(reading.value);
  send('R', number, &reading, sizeof reading);
}

void send_identity(uint8_t kind, uint8_t number) {
  Identity identity = {PROTOCOL, SENSORS, {}, millis(), {}};
  memcpy(identity.threshold, threshold, sizeof threshold);
  memcpy(identity.name, "fixel-tactile", sizeof identity.name);
  send(kind, number, &identity, sizeof identity);
}

void send(uint8_t kind, uint8_t number, const void* content, uint8_t length) {
  uint8_t frame[4 + sizeof(Identity) + 2] = {REPLY, kind, number, length};
  memcpy(frame + 4, content, length);
  const uint16_t sum = checksum(frame + 1, length + 3);
  frame[length + 4] = sum & 0xFF;
  frame[length + 5] = sum >> 8;
  Serial.write(frame, length + 6);
}

// CRC-16 with polynomial 0x1021, started at 0xFFFF.
uint16_t checksum(const uint8_t* bytes, uint8_t length) {
  uint16_t sum = 0xFFFF;
  while (length--) sum = _crc_xmodem_update(sum, *bytes++);
  return sum;
}

uint16_t word_at(const uint8_t* bytes) { return bytes[0] | (uint16_t)bytes[1] << 8; }

// --- rest -------------------------------------------------------------------------------------

// The serial port or the millisecond timer wakes it; a quiet processor makes a quiet converter.
void sleep_until_something_happens() {
  noInterrupts();
  if (Serial.available() == 0) {
    sleep_enable();
    interrupts();  // takes effect after the next instruction: nothing is slept through
    sleep_cpu();
    sleep_disable();
  }
  interrupts();
}
