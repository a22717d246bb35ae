// Counters, gauges, histograms and tables, and the HTTP page where Prometheus reads them.
#ifndef RIPS_SERVICES_RUNTIME_METRICS_H_
#define RIPS_SERVICES_RUNTIME_METRICS_H_

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "services/runtime/mutex.h"

namespace rips {

class PageServer;
using MetricLabels = std::map<std::string, std::string>;

// A value that only grows. Copies are the same metric; a default-made one counts nothing. Any
// thread; valid while its Metrics lives.
class Counter {
 public:
  Counter() = default;
  // `by` must not be negative.
  void Increment(double by = 1) const;
  double Value() const;

 private:
  friend class Metrics;
  explicit Counter(void* cell) : cell_(cell) {}
  void* cell_ = nullptr;  // prometheus::Counter
};

// A value that goes up and down. As Counter otherwise.
class Gauge {
 public:
  Gauge() = default;
  void Set(double value) const;
  void Add(double by) const;
  double Value() const;

 private:
  friend class Metrics;
  explicit Gauge(void* cell) : cell_(cell) {}
  void* cell_ = nullptr;  // prometheus::Gauge
};

// Counts values by the bucket that holds them. As Counter otherwise.
class Histogram {
 public:
  Histogram() = default;
  void Observe(double value) const;

 private:
  friend class Metrics;
  explicit Histogram(void* cell) : cell_(cell) {}
  void* cell_ = nullptr;  // prometheus::Histogram
};

// One line of a table.
struct MetricSample {
  MetricLabels labels;
  double value = 0;

  friend bool operator==(const MetricSample&, const MetricSample&) = default;
};

// Gauges of one name that are replaced together: the page shows all of the old or all of the new.
// As Counter otherwise.
class GaugeTable {
 public:
  GaugeTable() = default;
  // Labels of the samples are distinct.
  void Replace(std::vector<MetricSample> samples) const;

 private:
  friend class Metrics;
  struct Cell;
  explicit GaugeTable(Cell* cell) : cell_(cell) {}
  Cell* cell_ = nullptr;
};

// The metrics of one process. Any thread.
class Metrics {
 public:
  Metrics();
  ~Metrics();
  Metrics(const Metrics&) = delete;
  Metrics& operator=(const Metrics&) = delete;

  // The metric of this name and these labels, made if new. `name` is a constant such as
  // `rips_observations_total` and always comes with the same kind, help and label names.
  Counter AddCounter(const std::string& name, const std::string& help, MetricLabels labels = {});
  Gauge AddGauge(const std::string& name, const std::string& help, MetricLabels labels = {});
  // `bounds` are the upper ends of the buckets, ascending; the last bucket has no end.
  Histogram AddHistogram(const std::string& name, const std::string& help,
                         const std::vector<double>& bounds, MetricLabels labels = {});
  // No other metric has its name. Not on the page while it has no samples.
  GaugeTable AddTable(const std::string& name, const std::string& help) ABSL_LOCKS_EXCLUDED(mu_);

  // Counters, gauges and histograms with labels are on the page while `shown` is true of them.
  // They keep counting, since others may hold them. Called by Text; must not call this.
  using Shown = std::function<bool(const MetricLabels&)>;
  void SetShown(Shown shown) ABSL_LOCKS_EXCLUDED(mu_);

  // All metrics in the Prometheus text format 0.0.4.
  std::string Text() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Registry;
  mutable Mutex mu_;
  Shown shown_ ABSL_GUARDED_BY(mu_);
  // By name.
  std::map<std::string, std::unique_ptr<GaugeTable::Cell>> tables_ ABSL_GUARDED_BY(mu_);
  std::unique_ptr<Registry> registry_;
};

// Serves GET /metrics, /healthz (200 while the process runs) and /readyz (200, or 503 and why not).
// Plain HTTP without authentication: meant for loopback; any other address is warned of in the log.
// Slow clients do not keep others waiting (page_server.h); those that are closed are counted in
// rips_metrics_connections_dropped_total.
class MetricsServer {
 public:
  // Says whether the daemon does its job now. Called on a thread of the server, one call at a time.
  using Ready = std::function<absl::Status()>;

  // Listens on `address` (`HOST:PORT` with a numeric host; port 0 = any). An empty address gives a
  // server that does nothing. InvalidArgument for a bad address, Unavailable if it cannot bind.
  // `metrics` is not owned and outlives the server.
  static absl::StatusOr<std::unique_ptr<MetricsServer>> Start(absl::string_view address,
                                                              Metrics* metrics, Ready ready);
  ~MetricsServer();

  // Where it listens, `127.0.0.1:9464`; empty if it does not.
  const std::string& address() const { return address_; }

 private:
  MetricsServer();
  std::unique_ptr<PageServer> pages_;
  std::string address_;
};

// The page of a daemon, which works with or without it: while the address is taken it tries again,
// after 1 s and then doubled up to 30 s, and says so in the log. Counted in
// rips_metrics_bind_failures_total.
class MetricsPage {
 public:
  // InvalidArgument for a bad address; no other errors. `taken` is called, here, if the first
  // attempt failed; may be empty. `metrics` as in MetricsServer.
  static absl::StatusOr<std::unique_ptr<MetricsPage>> Start(
      const std::string& address, Metrics* metrics, MetricsServer::Ready ready,
      const std::function<void(const absl::Status&)>& taken = {},
      absl::Duration first_delay = absl::Seconds(1));
  ~MetricsPage();

  // Where it is served; empty if it is not, or not yet. Any thread.
  std::string address() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  MetricsPage(std::string address, Metrics* metrics, MetricsServer::Ready ready)
      : wanted_(std::move(address)), metrics_(metrics), ready_(std::move(ready)) {}
  // Error: not served, for this reason.
  absl::Status TryToServe() ABSL_LOCKS_EXCLUDED(mu_);
  void Run(absl::Duration delay) ABSL_LOCKS_EXCLUDED(mu_);

  const std::string wanted_;
  Metrics* metrics_;
  const MetricsServer::Ready ready_;
  Counter failures_;
  mutable Mutex mu_;
  CondVar stop_cond_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::unique_ptr<MetricsServer> server_ ABSL_GUARDED_BY(mu_);
  std::thread thread_;  // only if the first attempt failed
};

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_METRICS_H_
