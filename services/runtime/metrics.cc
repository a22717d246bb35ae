#include "services/runtime/metrics.h"

#include <algorithm>
#include <exception>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "civetweb.h"
#include "prometheus/counter.h"
#include "prometheus/gauge.h"
#include "prometheus/registry.h"
#include "prometheus/text_serializer.h"
#include "services/base/check.h"
#include "services/runtime/log.h"

namespace rips {
namespace {

constexpr absl::Duration kPageRetryMax = absl::Seconds(30);

}  // namespace

void Counter::Increment(double by) const {
  if (cell_ != nullptr) static_cast<prometheus::Counter*>(cell_)->Increment(by);
}

double Counter::Value() const {
  return cell_ == nullptr ? 0 : static_cast<prometheus::Counter*>(cell_)->Value();
}

void Gauge::Set(double value) const {
  if (cell_ != nullptr) static_cast<prometheus::Gauge*>(cell_)->Set(value);
}

void Gauge::Add(double by) const {
  if (cell_ != nullptr) static_cast<prometheus::Gauge*>(cell_)->Increment(by);
}

double Gauge::Value() const {
  return cell_ == nullptr ? 0 : static_cast<prometheus::Gauge*>(cell_)->Value();
}

struct Metrics::Registry {
  prometheus::Registry registry{prometheus::Registry::InsertBehavior::Merge};
};

Metrics::Metrics() : registry_(std::make_unique<Registry>()) {}
Metrics::~Metrics() = default;

Counter Metrics::AddCounter(const std::string& name, const std::string& help, MetricLabels labels) {
  try {
    return Counter(&prometheus::BuildCounter()
                        .Name(name)
                        .Help(help)
                        .Register(registry_->registry)
                        .Add(labels));
  } catch (const std::exception&) {
    RIPS_CHECK(false, "a metric has a wrong name or two kinds");
  }
}

Gauge Metrics::AddGauge(const std::string& name, const std::string& help, MetricLabels labels) {
  try {
    return Gauge(
        &prometheus::BuildGauge().Name(name).Help(help).Register(registry_->registry).Add(labels));
  } catch (const std::exception&) {
    RIPS_CHECK(false, "a metric has a wrong name or two kinds");
  }
}

std::string Metrics::Text() const {
  return prometheus::TextSerializer().Serialize(registry_->registry.Collect());
}

struct MetricsServer::Http {
  const Metrics* metrics = nullptr;
  Ready ready;
  mg_context* context = nullptr;

  static int Answer(mg_connection* connection, int code, absl::string_view type,
                    absl::string_view body) {
    const std::string head = absl::StrCat(
        "HTTP/1.1 ", code, code == 200 ? " OK" : " Refused", "\r\nContent-Type: ", type,
        "\r\nContent-Length: ", body.size(), "\r\nConnection: close\r\n\r\n", body);
    mg_write(connection, head.data(), head.size());
    return code;
  }

  static int Handle(mg_connection* connection, void* data) {
    const Http& self = *static_cast<Http*>(data);
    const mg_request_info* request = mg_get_request_info(connection);
    if (absl::string_view(request->request_method) != "GET") {
      return Answer(connection, 405, "text/plain", "only GET\n");
    }
    const absl::string_view path = request->local_uri;
    if (path == "/metrics") {
      return Answer(connection, 200, "text/plain; version=0.0.4", self.metrics->Text());
    }
    if (path == "/healthz") return Answer(connection, 200, "text/plain", "ok\n");
    if (path == "/readyz") {
      const absl::Status ready = self.ready ? self.ready() : absl::OkStatus();
      return ready.ok()
                 ? Answer(connection, 200, "text/plain", "ready\n")
                 : Answer(connection, 503, "text/plain", absl::StrCat(ready.message(), "\n"));
    }
    return Answer(connection, 404, "text/plain", "try /metrics, /healthz or /readyz\n");
  }
};

MetricsServer::MetricsServer() = default;

MetricsServer::~MetricsServer() {
  if (http_ == nullptr || http_->context == nullptr) return;
  mg_stop(http_->context);
  mg_exit_library();
}

absl::StatusOr<std::unique_ptr<MetricsServer>> MetricsServer::Start(absl::string_view address,
                                                                    const Metrics* metrics,
                                                                    Ready ready) {
  std::unique_ptr<MetricsServer> server(new MetricsServer());
  if (address.empty()) return server;
  const size_t colon = address.rfind(':');
  int port = 0;
  if (colon == absl::string_view::npos || colon == 0 ||
      !absl::SimpleAtoi(address.substr(colon + 1), &port) || port < 0 || port > 65535 ||
      address.find_first_not_of("0123456789abcdefABCDEF.:[]") != absl::string_view::npos) {
    return absl::InvalidArgumentError(
        absl::StrCat("metrics address `", address, "` is not HOST:PORT; use `127.0.0.1:9464`"));
  }
  server->http_ = std::make_unique<Http>();
  server->http_->metrics = metrics;
  server->http_->ready = std::move(ready);
  mg_init_library(0);
  const std::string listen(address);
  const char* options[] = {
      "listening_ports",   listen.c_str(), "num_threads", "2", "request_timeout_ms", "5000",
      "enable_keep_alive", "no",           nullptr};
  mg_callbacks callbacks{};
  callbacks.log_message = [](const mg_connection*, const char*) { return 1; };
  mg_context* context = mg_start(&callbacks, server->http_.get(), options);
  if (context == nullptr) {
    mg_exit_library();
    return absl::UnavailableError(
        absl::StrCat("cannot serve metrics on `", address, "`; is the port in use?"));
  }
  server->http_->context = context;
  mg_set_request_handler(context, "**", &Http::Handle, server->http_.get());
  mg_server_port bound{};
  mg_get_server_ports(context, 1, &bound);
  server->address_ = absl::StrCat(address.substr(0, colon), ":", bound.port);
  return server;
}

// --- MetricsPage

absl::StatusOr<std::unique_ptr<MetricsPage>> MetricsPage::Start(
    const std::string& address, Metrics* metrics, MetricsServer::Ready ready,
    const std::function<void(const absl::Status&)>& taken, absl::Duration first_delay) {
  std::unique_ptr<MetricsPage> page(new MetricsPage(address, metrics, std::move(ready)));
  page->failures_ = metrics->AddCounter("rips_metrics_bind_failures_total",
                                        "Attempts to serve this page that found its port taken.");
  const absl::Status served = page->TryToServe();
  if (served.ok()) return page;
  if (absl::IsInvalidArgument(served)) return served;
  LogError("metrics are not served; trying again until they are", {{"reason", served.message()}});
  if (taken) taken(served);
  page->thread_ = std::thread([page = page.get(), first_delay] { page->Run(first_delay); });
  return page;
}

MetricsPage::~MetricsPage() {
  {
    MutexLock lock(&mu_);
    stopping_ = true;
    stop_cond_.NotifyAll();
  }
  if (thread_.joinable()) thread_.join();
}

std::string MetricsPage::address() const {
  MutexLock lock(&mu_);
  return server_ == nullptr ? "" : server_->address();
}

absl::Status MetricsPage::TryToServe() {
  auto server = MetricsServer::Start(wanted_, metrics_, ready_);
  if (!server.ok()) {
    failures_.Increment();
    return server.status();
  }
  MutexLock lock(&mu_);
  server_ = *std::move(server);
  return absl::OkStatus();
}

void MetricsPage::Run(absl::Duration delay) {
  while (true) {
    {
      MutexLock lock(&mu_);
      while (!stopping_ && stop_cond_.WaitFor(lock, delay)) {
      }
      if (stopping_) return;
    }
    if (TryToServe().ok()) {
      LogInfo("listening", {{"metrics", address()}});
      return;
    }
    delay = std::min(2 * delay, kPageRetryMax);
  }
}

}  // namespace rips
