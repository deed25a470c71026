// A whole client of Stampede RT in Go, generated from proto/ alone: bind, open a channel, subscribe, put, get.
// Usage: client ADDRESS SECRET_FILE CHANNEL TEXT...
// Puts each TEXT as one item. Prints the seqs of its puts, the items of the last 30 s and the items of the subscription.
package main

import (
	"context"
	"crypto/rand"
	"encoding/json"
	"errors"
	"io"
	"log"
	random "math/rand/v2"
	"os"
	"strings"
	"time"

	"google.golang.org/genproto/googleapis/rpc/errdetails"
	"google.golang.org/grpc"
	"google.golang.org/grpc/credentials/insecure"
	"google.golang.org/grpc/metadata"
	"google.golang.org/grpc/status"

	v1 "stampede-rt.example/polyglot/v1"
)

type item struct {
	Time, Seq int64
	Text      string
}

type channel struct {
	data  v1.ChannelServiceClient // at its owner
	id    []byte
	epoch uint64 // every request names it
}

// must ends the program with the reason that the server gave: one ErrorInfo inside the status.
func must[T any](value T, err error) T {
	if err == nil {
		return value
	}
	for _, detail := range status.Convert(err).Details() {
		if info, ok := detail.(*errdetails.ErrorInfo); ok && info.Domain == "stampede-rt" {
			log.Fatalf("%s: %s %v", info.Reason, status.Convert(err).Message(), info.Metadata)
		}
	}
	log.Fatal(err)
	return value
}

func check(err error) { must(0, err) }

func dial(target string) *grpc.ClientConn {
	size := grpc.WithDefaultCallOptions(grpc.MaxCallRecvMsgSize(20 << 20)) // one item may have 16 MiB
	return must(grpc.NewClient(target, grpc.WithTransportCredentials(insecure.NewCredentials()), size))
}

// open goes the whole way once: front-end -> supernode -> gatekeeper -> data endpoint.
func open(ctx context.Context, address, name string) (context.Context, channel) {
	bound := must(v1.NewFrontendServiceClient(dial(address)).Bind(ctx, &v1.BindRequest{ProtocolVersion: 1}))
	ctx = metadata.AppendToOutgoingContext(ctx, "stampede-cluster-id", bound.ClusterId)  // servers of other clusters refuse this client
	directory := v1.NewDirectoryServiceClient(dial(bound.Supernodes[0].Endpoint.Target)) // the best one comes first
	minute, request := int64(time.Minute), make([]byte, 16)
	must(rand.Read(request)) // repeating a request id repeats the answer, not the operation
	opened := must(directory.OpenChannel(ctx, &v1.OpenChannelRequest{
		RequestId: request, Name: name, Create: true,
		Spec: &v1.ChannelSpec{Retention: &v1.RetentionPolicy{MaxAgeNanos: &minute}},
	}))
	gatekeeper := v1.NewGatekeeperServiceClient(dial(opened.Host.Gatekeepers[0].Target))
	place := must(gatekeeper.BindChannel(ctx, &v1.BindChannelRequest{
		ChannelId: opened.Channel.ChannelId, Epoch: opened.Channel.Epoch,
	}))
	data := v1.NewChannelServiceClient(dial(place.Endpoints[0].Target))
	return ctx, channel{data, place.Channel.ChannelId, place.Channel.Epoch}
}

// put sends runs of one item and reads their acks, which come in order.
func (c channel) put(ctx context.Context, texts []string) (seqs []uint64) {
	stream := must(c.data.Put(ctx))
	producer := random.Uint64() // this id and the numbers make retries safe
	for number, text := range texts {
		run := &v1.ItemRun{
			TimeUnixNano: []int64{time.Now().UnixNano()}, PayloadLengthBytes: []uint32{uint32(len(text))},
			ContentType: "text/plain", Payloads: []byte(text),
		}
		puts := []*v1.PutRun{{FirstNumber: uint64(number + 1), Run: run}}
		check(stream.Send(&v1.PutRequest{ChannelId: c.id, Epoch: c.epoch, ProducerId: producer, Puts: puts}))
	}
	check(stream.CloseSend())
	for len(seqs) < len(texts) {
		for _, ack := range must(stream.Recv()).Acks {
			if ack.Error != nil || len(ack.Rejections) > 0 {
				log.Fatalf("refused: %v %v", ack.Error, ack.Rejections)
			}
			seqs = append(seqs, ack.GetFirstSeq())
		}
	}
	return seqs
}

// last reads the items whose span shares an instant with the last `span`.
func (c channel) last(ctx context.Context, span time.Duration) (items []item) {
	now := &v1.Bound_MetaTime{MetaTime: v1.MetaTime_META_TIME_NOW}
	interval := &v1.Interval{Start: &v1.Bound{Anchor: now, OffsetNanos: -int64(span)}, End: &v1.Bound{Anchor: now}}
	stream := must(c.data.Get(ctx))
	check(stream.Send(&v1.GetRequest{CallId: 1, ChannelId: c.id, Epoch: c.epoch, Interval: interval}))
	check(stream.CloseSend())
	for {
		response, err := stream.Recv()
		if errors.Is(err, io.EOF) {
			return items
		}
		if must(response, err).Error != nil {
			log.Fatalf("refused: %v", response.Error)
		}
		items = append(items, unpack(response.Runs)...)
	}
}

// unpack cuts the columns of runs into items.
func unpack(runs []*v1.DeliveredRun) (items []item) {
	for _, delivered := range runs {
		run, at := delivered.Run, uint32(0)
		for i, length := range run.PayloadLengthBytes {
			items = append(items, item{run.TimeUnixNano[i], int64(run.FirstSeq) + int64(i), string(run.Payloads[at : at+length])})
			at += length
		}
	}
	return items
}

func main() {
	ctx, cancel := context.WithTimeout(context.Background(), 20*time.Second)
	defer cancel()
	ctx = metadata.AppendToOutgoingContext(ctx, "authorization", "Bearer "+strings.TrimSpace(string(must(os.ReadFile(os.Args[2])))))
	ctx, ch := open(ctx, os.Args[1], os.Args[3])
	news := must(ch.data.Subscribe(ctx))
	check(news.Send(&v1.SubscribeRequest{Open: &v1.SubscribeOpen{ChannelId: ch.id, Epoch: ch.epoch}, CreditBytes: 1 << 20}))
	must(news.Recv()) // has `opened`: from here on the subscription misses no item
	put := ch.put(ctx, os.Args[4:])
	var subscribed []item
	for len(subscribed) < len(put) {
		subscribed = append(subscribed, unpack(must(news.Recv()).Runs)...)
	}
	last := ch.last(ctx, 30*time.Second)
	check(json.NewEncoder(os.Stdout).Encode(map[string]any{"put": put, "last": last, "subscribed": subscribed}))
}
