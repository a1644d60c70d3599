using System;
using System.Collections.Concurrent;
using System.Collections.Generic;
using System.IO;
using System.Net.WebSockets;
using System.Text;
using System.Threading;
using System.Threading.Tasks;

namespace Armbridge
{
    /// <summary>
    /// A WebSocket that connects again by itself, after 0.5 s and then more slowly, up to every 10 s. Its work is done on
    /// threads of the pool; frames that come wait in a bounded queue until <see cref="TryTake"/>.
    /// </summary>
    public sealed class Connection : IDisposable
    {
        public static readonly TimeSpan FirstDelay = TimeSpan.FromSeconds(0.5);
        public static readonly TimeSpan LongestDelay = TimeSpan.FromSeconds(10);
        private const int LongestFrame = 16 * 1024 * 1024;
        private const int MostWaiting = 1024;
        private static readonly TimeSpan Deadline = TimeSpan.FromSeconds(10);

        private readonly Uri url;
        private readonly string token;
        private readonly IEnumerable<string> setup;
        private readonly CancellationTokenSource ending = new CancellationTokenSource();
        private readonly ConcurrentQueue<string> received = new ConcurrentQueue<string>();
        private readonly ConcurrentQueue<string> reports = new ConcurrentQueue<string>();
        private readonly SemaphoreSlim sending = new SemaphoreSlim(1, 1);
        private volatile ClientWebSocket open;
        private int waiting;

        /// <param name="token">authentication token, or empty.</param>
        /// <param name="setup">frames that begin each connection.</param>
        public Connection(string url, string token, IEnumerable<string> setup)
        {
            this.url = new Uri(url);
            this.token = token;
            this.setup = setup;
            Task.Run(Run);
        }

        public bool IsOpen
        {
            get { return open != null; }
        }

        /// <summary>The delay after one more connection that failed.</summary>
        public static TimeSpan NextDelay(TimeSpan delay)
        {
            return delay + delay < LongestDelay ? delay + delay : LongestDelay;
        }

        public bool TryTake(out string frame)
        {
            return received.TryDequeue(out frame);
        }

        /// <summary>Takes a sentence about the connection: that it was opened, or why it was lost.</summary>
        public bool TryTakeReport(out string report)
        {
            return reports.TryDequeue(out report);
        }

        /// <summary>Sends a frame. Returns false if there is no connection, or too much waits to be sent.</summary>
        public bool Send(string frame)
        {
            ClientWebSocket socket = open;
            if (socket == null)
            {
                return false;
            }
            if (Interlocked.Increment(ref waiting) > MostWaiting)
            {
                Interlocked.Decrement(ref waiting);
                return false;
            }
            _ = SendAndCount(socket, frame);
            return true;
        }

        /// <summary>Closes the connection, and with it ends this client's control lease.</summary>
        public void Dispose()
        {
            ending.Cancel();
        }

        private async Task Run()
        {
            TimeSpan delay = FirstDelay;
            while (!ending.IsCancellationRequested)
            {
                try
                {
                    using (var socket = new ClientWebSocket())
                    {
                        // A stop must not wait behind anything but the bytes before it.
                        socket.Options.KeepAliveInterval = TimeSpan.FromSeconds(5);
                        using (var deadline = CancellationTokenSource.CreateLinkedTokenSource(ending.Token))
                        {
                            deadline.CancelAfter(Deadline);
                            await socket.ConnectAsync(url, deadline.Token);
                        }
                        if (token.Length > 0)
                        {
                            await SendOn(socket, Frames.Authenticate(token));
                        }
                        foreach (string frame in setup)
                        {
                            await SendOn(socket, frame);
                        }
                        open = socket;
                        delay = FirstDelay;
                        Report("connected to " + url);
                        await Receive(socket);
                    }
                }
                catch (Exception error)
                {
                    if (ending.IsCancellationRequested)
                    {
                        return;
                    }
                    Report("no connection to " + url + ": " + error.Message);
                }
                finally
                {
                    open = null;
                }
                try
                {
                    await Task.Delay(delay, ending.Token);
                }
                catch (TaskCanceledException)
                {
                    return;
                }
                delay = NextDelay(delay);
            }
        }

        private async Task Receive(ClientWebSocket socket)
        {
            var buffer = new ArraySegment<byte>(new byte[65536]);
            var frame = new MemoryStream();
            while (true)
            {
                WebSocketReceiveResult part = await socket.ReceiveAsync(buffer, ending.Token);
                if (part.MessageType == WebSocketMessageType.Close)
                {
                    Report("the server closed the connection: " + part.CloseStatusDescription);
                    return;
                }
                frame.Write(buffer.Array, 0, part.Count);
                if (frame.Length > LongestFrame)
                {
                    throw new IOException("a frame is longer than " + LongestFrame + " bytes");
                }
                if (part.EndOfMessage)
                {
                    received.Enqueue(Encoding.UTF8.GetString(frame.GetBuffer(), 0, (int)frame.Length));
                    frame.SetLength(0);
                    // A game that stands still for a while gets the newest.
                    while (received.Count > MostWaiting && received.TryDequeue(out string _))
                    {
                    }
                }
            }
        }

        private async Task SendAndCount(ClientWebSocket socket, string frame)
        {
            try
            {
                await SendOn(socket, frame);
            }
            catch (Exception error)
            {
                Report("a frame was not sent: " + error.Message);
            }
            finally
            {
                Interlocked.Decrement(ref waiting);
            }
        }

        private async Task SendOn(ClientWebSocket socket, string frame)
        {
            // A ClientWebSocket takes one message at a time.
            await sending.WaitAsync(ending.Token);
            try
            {
                var bytes = new ArraySegment<byte>(Encoding.UTF8.GetBytes(frame));
                await socket.SendAsync(bytes, WebSocketMessageType.Text, true, ending.Token);
            }
            finally
            {
                sending.Release();
            }
        }

        private void Report(string sentence)
        {
            if (reports.Count < MostWaiting)
            {
                reports.Enqueue(sentence);
            }
        }
    }
}
