/* An emulated Arduino Mega 2560 whose serial port is a pseudo-terminal. A test tool: it links
 * libsimavr, which is under the GPL version 3, and is therefore built where it is used and never
 * distributed with fixel.
 *
 *   emulated_mega FIRMWARE.elf LINK
 *
 * LINK becomes a symbolic link to the pseudo-terminal, which a program opens like a real port.
 * The clock keeps to real time (16 MHz) as long as the computer can follow.
 *
 * Standard input takes a command a line; each is answered on standard output by "ok", "ok VALUE"
 * or "error". End of input ends the emulator.
 *
 *   adc CHANNEL MILLIVOLTS          the voltage at an analogue pin, from now on
 *   at MS adc CHANNEL MILLIVOLTS    the same, so many milliseconds from now
 *   drop N                          the next N bytes to the host are lost
 *   garble N                        the next N bytes to the host arrive with other bits
 *   lose N                          the next N bytes from the host are lost
 *   stray BYTE                      the host receives a byte nobody sent
 *   delay MS                        every byte to the host comes so much later; 0 ends that
 *   reset MS                        the board restarts, and is deaf while its boot loader runs
 *   unplug, plug                    the port goes away, and comes back under LINK
 *   time                            microseconds since the firmware started
 */
#define _GNU_SOURCE /* ppoll */
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pty.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include <simavr/avr_adc.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>

#define CYCLES_PER_US 16
#define SLICE_US 200  /* emulate this much, then look at the port, the commands and the clock */
#define SETUP_MS 5    /* a byte that arrives before the receiver is on jams simavr 1.6 */
#define EVENTS 512
#define SENT 4096

struct event { avr_cycle_count_t when; unsigned channel, millivolts; };
struct byte { avr_cycle_count_t when; uint8_t value; };

static avr_t *avr;
static avr_irq_t *uart_in, *adc_in;
static const char *link_path;
static char pty_name[128];
static int master = -1, slave = -1;
static int board_listens = 1;
static unsigned to_drop, to_garble, to_lose;
static avr_cycle_count_t delay, deaf_until;
static struct event events[EVENTS];
static unsigned n_events;
static struct byte sent[SENT];  /* a ring, in order of time */
static unsigned sent_first, n_sent;

/* --- the port ------------------------------------------------------------------------------ */

static int plug(void) {
  struct termios raw;
  struct stat there;
  if (master >= 0) return 0;
  if (!lstat(link_path, &there) && !S_ISLNK(there.st_mode)) return errno = EEXIST, -1;
  if (openpty(&master, &slave, pty_name, NULL, NULL)) return -1;
  /* The slave stays open here: the master must not see a hang-up between two programs. */
  tcgetattr(slave, &raw);
  cfmakeraw(&raw);
  tcsetattr(slave, TCSANOW, &raw);
  fcntl(master, F_SETFL, O_NONBLOCK);
  unlink(link_path);
  return symlink(pty_name, link_path);
}

static void unplug(void) {
  if (master < 0) return;
  unlink(link_path);
  close(slave);
  close(master);
  master = slave = -1;
}

static void arrive(uint8_t value) {
  if (to_drop) { --to_drop; return; }
  if (to_garble) { --to_garble; value ^= 0x5A; }
  /* A pseudo-terminal nobody reads is full at some point: a real wire would lose it too. */
  if (master >= 0 && write(master, &value, 1) != 1) return;
}

static void on_sent(struct avr_irq_t *irq, uint32_t value, void *param) {
  (void)irq; (void)param;
  if (n_sent == SENT) return;
  struct byte *b = &sent[(sent_first + n_sent++) % SENT];
  b->when = avr->cycle + delay;
  b->value = value;
}
static void on_listens(struct avr_irq_t *irq, uint32_t v, void *p) { (void)irq; (void)v; (void)p; board_listens = 1; }
static void on_full(struct avr_irq_t *irq, uint32_t v, void *p) { (void)irq; (void)v; (void)p; board_listens = 0; }

static void deliver(void) {
  uint8_t value;
  while (n_sent && sent[sent_first].when <= avr->cycle) {
    arrive(sent[sent_first].value);
    sent_first = (sent_first + 1) % SENT;
    --n_sent;
  }
  while (master >= 0 && board_listens && read(master, &value, 1) == 1) {
    if (avr->cycle < deaf_until) continue;
    if (to_lose) { --to_lose; continue; }
    avr_raise_irq(uart_in, value);
  }
}

/* --- the board ----------------------------------------------------------------------------- */

static void run_for(avr_cycle_count_t cycles) {
  const avr_cycle_count_t until = avr->cycle + cycles;
  while (avr->cycle < until) {
    const int state = avr_run(avr);
    if (state == cpu_Done || state == cpu_Crashed) {
      fprintf(stderr, "the processor stopped\n");
      exit(1);
    }
  }
}

static void restart(unsigned boot_ms) {
  const avr_cycle_count_t ms = 1000 * CYCLES_PER_US;
  avr_reset(avr);
  board_listens = 1;
  n_sent = 0;
  run_for(SETUP_MS * ms);
  deaf_until = avr->cycle + boot_ms * ms;
}

static void set_voltages(void) {
  for (unsigned k = 0; k < n_events;) {
    if (events[k].when > avr->cycle) { ++k; continue; }
    avr_raise_irq(adc_in + ADC_IRQ_ADC0 + events[k].channel, events[k].millivolts);
    memmove(events + k, events + k + 1, (--n_events - k) * sizeof *events);
  }
}

static void sleep_not(avr_t *a, avr_cycle_count_t cycles) { (void)a; (void)cycles; /* the clock below waits */ }

static void say_errors(avr_t *a, const int level, const char *format, va_list values) {
  (void)a;
  if (level <= LOG_ERROR) vfprintf(stderr, format, values);
}

/* --- commands ------------------------------------------------------------------------------ */

static int add_event(unsigned ms, unsigned channel, unsigned millivolts) {
  if (channel > 15 || millivolts > 5000 || n_events == EVENTS) return -1;
  events[n_events++] = (struct event){avr->cycle + (avr_cycle_count_t)ms * 1000 * CYCLES_PER_US, channel, millivolts};
  set_voltages();
  return 0;
}

static void obey(const char *line) {
  unsigned a, b, c;
  int failed = 0;
  if (sscanf(line, "adc %u %u", &a, &b) == 2) failed = add_event(0, a, b);
  else if (sscanf(line, "at %u adc %u %u", &a, &b, &c) == 3) failed = add_event(a, b, c);
  else if (sscanf(line, "drop %u", &a) == 1) to_drop = a;
  else if (sscanf(line, "garble %u", &a) == 1) to_garble = a;
  else if (sscanf(line, "lose %u", &a) == 1) to_lose = a;
  else if (sscanf(line, "stray %u", &a) == 1) arrive(a);
  else if (sscanf(line, "delay %u", &a) == 1) delay = (avr_cycle_count_t)a * 1000 * CYCLES_PER_US;
  else if (sscanf(line, "reset %u", &a) == 1) restart(a);
  else if (!strcmp(line, "unplug")) unplug();
  else if (!strcmp(line, "plug")) failed = plug();
  else if (!strcmp(line, "time")) {
    printf("ok %llu\n", (unsigned long long)avr->cycle / CYCLES_PER_US);
    fflush(stdout);
    return;
  } else failed = 1;
  puts(failed ? "error" : "ok");
  fflush(stdout);
}

/* Whether there is more to come. */
static int read_commands(void) {
  static char line[128];
  static size_t fill;
  char ch;
  ssize_t n;
  while ((n = read(0, &ch, 1)) == 1) {
    if (ch != '\n') {
      if (fill < sizeof line - 1) line[fill++] = ch;
      continue;
    }
    line[fill] = 0;
    fill = 0;
    obey(line);
  }
  return n != 0;
}

/* --- the clock ----------------------------------------------------------------------------- */

static double now(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}

/* Wait until the emulated time has come, or the host has something to say. */
static void wait_for(double seconds) {
  struct pollfd heard[2] = {{.fd = 0, .events = POLLIN}, {.fd = master, .events = POLLIN}};
  struct timespec limit = {(time_t)seconds, (long)((seconds - (time_t)seconds) * 1e9)};
  ppoll(heard, master >= 0 && board_listens ? 2 : 1, &limit, NULL);
}

int main(int argc, char **argv) {
  if (argc != 3) return fprintf(stderr, "usage: emulated_mega FIRMWARE.elf LINK\n"), 2;
  link_path = argv[2];
  avr_global_logger_set(say_errors);

  elf_firmware_t firmware;
  memset(&firmware, 0, sizeof firmware);
  if (elf_read_firmware(argv[1], &firmware)) return fprintf(stderr, "cannot read %s\n", argv[1]), 1;
  avr = avr_make_mcu_by_name("atmega2560");
  if (!avr) return fprintf(stderr, "simavr knows no atmega2560\n"), 1;
  avr_init(avr);
  avr_load_firmware(avr, &firmware);
  avr->frequency = CYCLES_PER_US * 1000000;
  avr->vcc = avr->avcc = avr->aref = 5000;
  avr->sleep = sleep_not;

  uint32_t flags = 0; /* no echo on standard output, no waiting while the firmware polls */
  avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_sent, NULL);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XON), on_listens, NULL);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XOFF), on_full, NULL);
  uart_in = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
  adc_in = avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, 0);

  restart(0);
  if (plug()) return perror(link_path), 1;
  fcntl(0, F_SETFL, O_NONBLOCK);
  printf("ready %s\n", pty_name);
  fflush(stdout);

  double started = now();
  avr_cycle_count_t first = avr->cycle;
  while (read_commands()) {
    run_for((avr_cycle_count_t)SLICE_US * CYCLES_PER_US);
    set_voltages();
    deliver();
    const double ahead = (avr->cycle - first) / (1e6 * CYCLES_PER_US) - (now() - started);
    if (ahead > 0) {
      wait_for(ahead);
    } else if (ahead < -0.1) { /* the computer was busy: go on from here rather than race */
      started = now();
      first = avr->cycle;
    }
  }
  unplug();
  avr_terminate(avr);
  return 0;
}
